"""Known defects of engines, each with its reason and its size. They show as "known" and pass; one that vanishes fails.

An entry is written only after its cause is understood or documented by the engine, never to silence a finding. It
excuses no more than about the size that was measured.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Container, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.document import Finding, Run

if TYPE_CHECKING:
    from crosscheck.scene.model import Scene

Turning = Callable[[str, "Scene", str | None], Sequence[int]]
"""From engine, scene and form to the bodies that the engine's model has on SO(3): `crosscheck.adapters.turning`."""

STATE = ("position", "attitude", "velocity", "angular velocity")


MARGIN = 10.0
"""Times the largest size that was measured, beyond which a defect excuses nothing: steps, versions and processors move
errors by factors of a few."""

ORDER_MARGIN = 0.5
"""An order may fall short by so much more than was measured."""

SIZE_MARGIN = 2.0
"""Times the errors of the main run that were measured with a defect, beyond which it excuses nothing at all."""

RISING = -0.25
"""Orders below it are those of errors that rise as steps shrink. What a wrong model leaves does not: its order is 0."""

RISES = "errors rise as steps shrink, as rounding does that adds up from step to step"


@dataclasses.dataclass(frozen=True)
class Known:
    """A defect: in which runs and findings it shows, how large it was, and why it is there."""

    engine: str
    versions: tuple[str, ...]  # each stands for every version that begins so, as "3" for 3.3.7
    methods: tuple[str, ...]
    scenes: Container[str] | Callable[[str, str | None, Turning], bool] | None  # names or paths, or a rule; None: any
    forms: tuple[str, ...] | None  # None: any form
    kinds: Mapping[str, float]  # of findings: the largest value over its bound that was measured; of orders, the lack
    reason: str
    practical: bool = False  # shows at the plan's practical step, and is not looked for elsewhere
    always: bool = True  # it has to show in every such run: where it does not, it has vanished
    rising: bool = False  # of orders it excuses only those of errors that rise as steps shrink
    sizes: Mapping[str, float] = dataclasses.field(default_factory=dict)  # by kind of finding, of the main run with it

    def excuses(self, finding: Finding) -> bool:
        """Whether a failing finding is of a kind and a size that the defect explains."""
        most = self.kinds.get(finding.kind)
        if most is None or finding.value is None or finding.bound is None:
            return most is not None
        if finding.kind.startswith("order"):
            if self.rising and not finding.value <= RISING:
                return False
            return finding.bound - finding.value <= most + ORDER_MARGIN
        return finding.value <= MARGIN * most * finding.bound

    def alike(self, findings: Sequence[Finding]) -> bool:
        """Whether the errors of a run are about as large as with this defect alone, as far as these were measured.

        A defect that hides the orders of errors would otherwise hide a wrong model, too.
        """
        return not any(finding.value is not None and not finding.value <= SIZE_MARGIN * self.sizes[finding.kind]
                       for finding in findings if finding.kind in self.sizes)

    def covers(self, run: Run, turning: Turning) -> bool:
        """Whether the entry is about this run."""
        return (self.practical == run.practical and self.engine == run.engine.partition("==")[0]
                and any(f"{run.version}.".startswith(f"{version}.") for version in self.versions)
                and run.method in self.methods and (self.forms is None or run.form in self.forms)
                and (self.scenes is None or (self.scenes(run.scene, run.form, turning) if callable(self.scenes)
                                             else run.scene in self.scenes)))


GYROSCOPIC = ("the gyroscopic torque is taken at the start of the step, which multiplies the wobble of a body "
              "spinning at rate w by about sqrt(1 + (w h)^2) a step; here w h = 0.15, and the run explodes within the "
              "second; at the speeds it reaches rounding alone exceeds the bounds of the constraint levels")
UNSTABILIZED = ("nothing holds the positions: at this step the body leaves its joint, by decimetres with DAE2H_LE and "
                "by metres with INDEX1_LE within the second, and its weight does work on the way")

NAIVE = ("summing the joint velocities of the stages and integrating once is second order where a joint turns on "
         "SO(3): velocities at different attitudes do not add there; order 4 is what such code is written for")
OPENED = f"{NAIVE}; it shows in every part of a run, and joints of bodies that are turned wrong by as much come apart"
SINGULAR = ("nothing holds the positions, and where all bars lie on one line the constraints lose a rank: close to it "
            "a drift e of a joint is a displacement e / angle and a velocity e w / angle^2, which no step resolves; on "
            "the parallelogram at 2 ms the first passage turns 1e-11 m into 2e-6 m and the second into 0.05 m. In "
            "joint coordinates only the loop drifts: on the parallelogram RKMK8 leaves it open by 6e-10 m at 1 ms, by "
            "1e-4 m at 2 ms")
TREE_NEWTON = ("in joint coordinates Newton's iteration contracts slowly, 8 to 14 times a step on chain_64, and at "
               "larger steps not at all: it ends at 18 ms there with any tolerance from 1e-9 to 1e-6, with 200 "
               "iterations and with a numerical Jacobian; explicit methods run on the same model to their order")
NEWTON_NOISE = ("with 64 bodies the tightest tolerance at which Newton's iteration ends is 1e-9; a constraint left "
                "open by e is an error e / h of velocities, so that errors grow again below 0.2 ms. Above, second "
                "order shows: 3.8e-7, 9.5e-8, 2.4e-8 m at 0.8, 0.4, 0.2 ms")
AXIS_ROWS = ("velocity rows are components of the relative angular velocity, the derivatives of the position rows "
             "only where these are closed; an index-2 method leaves them open by a second-order drift, and so its "
             "velocities by the same: 1e-5, 2.5e-6, 6e-7 m/s at 2, 1, 0.5 ms")
LIGHT_NODES = ("bodies of 1e-7 kg m^2 on Lie group nodes: Newton's residual of GeneralizedAlpha ends at 2e-7 N, which "
               "leaves .004, .012, .018 rad/s at 20, 5, 1.25 us; TrapezoidalIndex2 loses attitudes, 4.8e-7, 9.1e-7, "
               "5.5e-6 rad, whatever Newton's tolerance. Euler parameters and joint coordinates show order 2")
OVERREACH = ("the inner steps of a composition reach beyond the ends of a step, and so over a break of a function of "
             "time: where its third derivative jumps, the step beside the break is of order 4. On driven_cart, at 20 "
             "and 10 ms, velocities at the break are off by 1.8e-10 and 1.1e-11 m/s; with the first piece of the "
             "spline held for ever, by 8.6e-12 and 3.5e-14: order 8")
CONTRADICTORY = ("the linkage moves only because its redundant rows repeat the others where the positions are exact; "
                 "this method holds no positions, and off them the rows contradict each other: no velocity or "
                 "acceleration satisfies them all, and their least squares leave what is seen")
CARDAN = ("in joint coordinates a ball is three rotations; where the second comes near a right angle the others turn "
          "about almost one axis, the equations stiffen as the inverse square of its cosine, and steps of this length "
          "end the run; this motion comes to a cosine of 0.08 or less in every order of the axes")
AXIAL = ("the discrete momentum about the needle's axis is J3 w3 (1 + h^2 w^2 J1 / (12 J3)) to second order, w the "
         "rate at which the axis turns: with J1 / J3 = 1e6 the spin comes right only where h^2 w^2 is far below 1e-5. "
         "The error is one of this spin alone, second order with that factor; with a spin-free frame, as in the "
         "compositions, it stays below J3 / J1 of a radian")
DELASSUS = ("reactions are found from G M^-1 G^T, in which the light body's share hides that of the heavy one: as many "
            "digits are lost as the masses differ by; a second pass with what the first leaves of G a + gamma would "
            "restore them, as it does in lieeuler, whose rows close to 3e-14 m/s^2 here")
DISCRETE = ("accelerations are evaluated at the run's states, for those of discrete are changes of velocities over a "
            "step; with soft joints that integrator leaves states in which their forces are others than in its steps: "
            "10 m/s^2 on the single pendulum, alike at 1 and at 0.25 ms")
ROLLING_START = ("the accelerations that Exudyn starts a rolling disk with lack gamma, the part of its rows that comes "
                 "from velocities: .43 m/s^2 on wobbling_disk, .79 on rolling_disk at any step. The trapezoidal rule "
                 "damps nothing and carries it on with alternating sign; GeneralizedAlpha loses a third of it a step")
ROTATED = ("Newton keeps the angular velocity of a ball in axes of the parent, MuJoCo Warp in those of the body. Every "
           "step turns it there and back by quaternions that single precision leaves longer than one, by 4e-8 on "
           "average, which multiplies it by 1 + 3e-7. Without that way the order shows: on triple_pendulum 1.4e-3 and "
           "7.9e-4 rad/s at 0.125 and 0.0625 ms, with it 7.7e-3 and 1.4e-2")
SPUN_UP = ("every step takes the angular velocity into the body and back by quaternions that single precision leaves "
           "longer than one, by 5e-8 on average, which multiplies it by 1 + 2e-7: on heavy_top 0.15, 0.27, 0.57 rad/s "
           "of 150 in 0.1 s at 20, 10, 5 us")
JITTER = ("every iteration of the joints turns the rounding of positions over the step into velocities: at 70 and 35 "
          "us on double_pendulum noise of 4e-4 and 9e-4 m/s with 4 iterations, 7e-4 and 1.6e-3 with 8, 2.9e-3 and 6e-3 "
          "with 32")
LEFT_BEHIND = ("what a joint corrects turns a body but not its angular velocity, which stays in world axes, so that a "
               "fast body loses spin: on heavy_top 13.4, 5.4, 2.3 rad/s of 150 in 1 s at 1, 0.5, 0.25 ms; the same "
               "steps in NumPy lose 13.4, 5.4, 2.4 in double precision, and 0.06, 0.008, 0.001 if the velocity turns "
               "with the body")
ORDERS = tuple(f"order {quantity}" for quantity in STATE)
SUMMED = dict.fromkeys(ORDERS, 1.9) | {
    "position": 34, "attitude": 140, "velocity": 67, "angular velocity": 94, "interval position": 430,
    "interval attitude": 690, "interval velocity": 110, "interval angular velocity": 130, "energy": 42, "momentum": 9.3}
"""Of summed joint velocities, on all scenes of the library; the largest on thrown_double at 10 ms."""
LOST = dict.fromkeys(ORDERS, 1.0) | {
    "run": 1.0, "position": 850, "attitude": 860, "velocity": 2500, "angular velocity": 5000, "interval attitude": 1.5,
    "interval velocity": 10, "interval angular velocity": 19, "energy": 64, "order intervals": 18,
    "limit position": 2300, "limit attitude": 3500, "limit velocity": 1300, "limit angular velocity": 2200,
    "level position": 25, "level velocity": 7}
"""Where all bars lie on one line, on the parallelogram: of RKMK8 at 10 ms and of SymplecticEuler at .2 ms."""


CONING = 0.1
"""Size of w x dw/dt over the largest |w| |dw/dt| of a body above which an axis of rotation moves for sure."""


@functools.lru_cache(maxsize=64)
def _naive(engine: str, scene: str, form: str | None, on_group: Turning) -> str:
    """Whether summed joint velocities show on a scene.

    "no": no joint of the model turns on SO(3); "surely": the axis of rotation of such a body moves from the start;
    "maybe": turns about one axis add up.
    """
    from crosscheck.errors import ArgumentError, SceneError
    from crosscheck.scene import mechanics
    from crosscheck.scene.file import as_scene

    try:
        loaded = as_scene(scene)
    except (ArgumentError, SceneError):  # no scene at all, so that nothing is known about it
        return "no"
    turning = list(on_group(engine, loaded, form))
    if not turning:
        return "no"
    _, alpha, _ = mechanics.index1(loaded, loaded.x0[None], loaded.R0[None], loaded.v0[None], loaded.w0[None])
    w, alpha = loaded.w0[turning], alpha[0, turning]
    speeds = np.linalg.norm(w, axis=1)
    sizes = speeds * np.linalg.norm(alpha, axis=1)
    # The direction of what rests, or does not accelerate, is rounding.
    least = max(CONING * sizes.max(), 1e-9 * speeds.max() ** 3)
    return "surely" if np.linalg.norm(np.cross(w, alpha), axis=1).max() > least else "maybe"


@functools.lru_cache(maxsize=64)
def _closes_loops(scene: str) -> bool:
    """Whether a scene has loops, which MuJoCo closes by soft joints."""
    from crosscheck.errors import ArgumentError, SceneError
    from crosscheck.scene.file import as_scene
    from crosscheck.scene.spanning import spanning_tree

    try:
        return bool(spanning_tree(as_scene(scene))[1])
    except (ArgumentError, SceneError):
        return False


def _summed(engine: str, word: str) -> Callable[[str, str | None, Turning], bool]:
    return lambda scene, form, turning: _naive(engine, scene, form, turning) == word


KNOWN: tuple[Known, ...] = (
    # The step decides which bounds of states are exceeded, but not whether an order is missed.
    Known("pinocchio", ("4",), ("RK4naive",), _summed("pinocchio", "surely"), None, SUMMED, NAIVE),
    Known("pinocchio", ("4",), ("RK4naive",), _summed("pinocchio", "maybe"), None, SUMMED, NAIVE, always=False),
    Known("pinocchio", ("4",), ("RK4naive",),
          lambda scene, form, turning: _naive("pinocchio", scene, form, turning) != "no", None,
          {"level position": 15, "level velocity": 5.4, "order intervals": 1.6}, OPENED, always=False),
    Known("mujoco", ("3",), ("RK4",), _summed("mujoco", "surely"), ("tree",), SUMMED, NAIVE),
    Known("mujoco", ("3",), ("RK4",), _summed("mujoco", "maybe"), ("tree",), SUMMED, NAIVE, always=False),
    *(Known(engine, ("3",), ("RK4",), _summed("mjx", word), ("tree",), kinds, NAIVE, always=always)
      for engine in ("mjx", "mjx-single") for word, kinds, always in (
          ("surely", SUMMED, engine == "mjx"), ("maybe", SUMMED, False), ("surely", {"order intervals": 1.6}, False))),
    Known("newton", ("1.8",), ("MuJoCoRK4",), ("heavy_top",), ("tree",), {
        "order position": 1.8, "order attitude": 1.8, "order velocity": 1.6, "order angular velocity": 1.9}, NAIVE,
        always=False),
    *(Known("newton", ("1.8",), ("MuJoCoEuler", "MuJoCoImplicitfast"), (scene,), ("tree",), kinds, ROTATED,
            always=False, rising=True, sizes=dict(zip(STATE, sizes, strict=True)))
      for scene, kinds, sizes in (
          ("triple_pendulum", dict.fromkeys(ORDERS, 2.0), (1.4e-3, 3.2e-3, 5.7e-3, 0.012)),
          ("heavy_top", dict.fromkeys(ORDERS, 2.0) | {"limit attitude": 5.6, "limit velocity": 1.8},
           (2.6e-3, 0.044, 0.074, 0.89)))),
    *(Known("newton", ("1.8",), ("MuJoCoRK4",), (scene,), ("tree",), dict.fromkeys(ORDERS[1:], 5.0), ROTATED,
            always=False, rising=True, sizes=dict(zip(STATE, sizes, strict=True)))
      for scene, sizes in (("double_pendulum", (3.4e-4, 2.5e-4, 1.8e-3, 1.5e-3)),
                           ("heavy_top", (8.1e-5, 1.9e-3, 2.5e-3, 0.040)))),
    *(Known("newton", ("1.8",), (method,), ("heavy_top",), None,
            dict.fromkeys(ORDERS, 2.0) | {"limit attitude": 5.2, "limit velocity": 1.4}, SPUN_UP, always=False,
            rising=True, sizes=dict(zip(STATE, sizes, strict=True)))
      for method, sizes in (("XPBD", (1.9e-4, 0.035, 0.076, 0.71)), ("SemiImplicit", (1.6e-4, 0.029, 8e-3, 0.57)))),
    Known("newton", ("1.8",), ("XPBD",), ("double_pendulum", "triple_pendulum", "heavy_top"), None,
          {"interval velocity": 1.3, "interval angular velocity": 1.2}, JITTER, always=False),
    Known("pinocchio", ("4",), ("SymplecticEuler", "RK4naive", "RKMK4", "RKMK8"), ("parallelogram", "double_four_bar"),
          None, LOST, SINGULAR, always=False),
    Known("pinocchio", ("4",), ("SymplecticEuler", "RK4naive", "RKMK4", "RKMK8"), ("light_heavy",), ("maximal",),
          {"level acceleration": 1.9}, DELASSUS, always=False),
    Known("lieeuler", ("0",), ("DAE2L_LE", "DAE2H_LE", "INDEX1_LE"), ("bricard",), None,
          {"level velocity": 3.8e6, "level acceleration": 6.9e4}, CONTRADICTORY, always=False),
    Known("lieeuler", ("0",), ("DAE3H_LE", "DAE2H_LE", "DAE2H_LSE", "DAE1H_LSE"), ("needle",), None,
          {"limit attitude": 72, "limit angular velocity": 49}, AXIAL),
    Known("lieeuler", ("0",), ("rattle4", "rattle6", "rattle8"), ("needle",), None, {
        "order attitude": 6.8, "order angular velocity": 6.8, "attitude": 4.5, "angular velocity": 3.1,
        "interval attitude": 1.7, "interval angular velocity": 1.6}, AXIAL, always=False),
    Known("lieeuler", ("0",), ("rattle8",), ("driven_cart",), None,
          {"order velocity": 3.9, "order angular velocity": 3.5}, OVERREACH, always=False),
    Known("exudyn", ("1",), ("TrapezoidalIndex2",), ("double_four_bar",), None, {"run": 1.0}, SINGULAR, always=False),
    Known("exudyn", ("1",), ("TrapezoidalIndex2",), ("bricard",), None, {"level velocity": 6.6e6}, CONTRADICTORY),
    Known("exudyn", ("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("squeezer",), ("maximal",), {
        "order attitude": 3.2, "order angular velocity": 2.0, "order intervals": 2.5, "noise": 3.0,
        "level velocity": 3200, "limit attitude": 64, "limit velocity": 27, "limit angular velocity": 4.1e4},
        LIGHT_NODES, always=False),
    Known("exudyn", ("1",), ("TrapezoidalIndex2",), ("branching_tree", "driven_double_pendulum", "twisted_pair"),
          ("maximal",), {"level velocity": 3.7e5}, AXIS_ROWS),
    Known("exudyn", ("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("chain_64", "light_heavy"), ("tree",),
          dict.fromkeys(ORDERS, 0.0) | {"run": 1.0}, TREE_NEWTON, always=False),
    Known("exudyn", ("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("chain_64",), ("maximal",), {
        "order attitude": 2.9, "limit position": 12, "limit attitude": 590, "limit velocity": 180,
        "limit angular velocity": 940}, NEWTON_NOISE, always=False),
    Known("exudyn", ("1",), ("GeneralizedAlpha", "TrapezoidalIndex2", "RK44", "RK67", "DOPRI5"),
          ("thrown_double", "thrown_triple"), None, {
              "run": 1.0, "interval position": 130, "interval attitude": 160, "interval velocity": 850,
              "interval angular velocity": 1100}, CARDAN, always=False),
    Known("mujoco", ("4",), ("Euler", "implicitfast", "discrete"), ("heavy_top",), None,
          {"energy": 7e8, "level velocity": 35, "level acceleration": 8.4e4}, GYROSCOPIC, practical=True),
    *(Known(engine, ("3",), ("Euler", "implicitfast"), ("heavy_top",), None,
            {"energy": 1.4e9, "level velocity": 18, "level acceleration": 6.7e4}, GYROSCOPIC, practical=True)
      for engine in ("mjx", "mjx-single")),
    Known("newton", ("1.8",), ("Featherstone", "MuJoCoEuler", "MuJoCoImplicitfast"), ("heavy_top",), None,
          {"energy": 5.3e8, "level velocity": 8.7}, GYROSCOPIC, practical=True),
    Known("newton", ("1.8",), ("XPBD",), ("heavy_top",), None, {"energy": 2.1}, LEFT_BEHIND, practical=True),
    Known("pinocchio", ("4",), ("SymplecticEuler",), ("heavy_top",), None,
          {"energy": 7e8, "level acceleration": 3800}, GYROSCOPIC, practical=True),
    Known("mujoco", ("4",), ("discrete",), lambda scene, form, turning: form == "maximal" or _closes_loops(scene), None,
          {"acceleration": 120, "angular acceleration": 93}, DISCRETE, always=False),
    Known("exudyn", ("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("rolling_disk", "wobbling_disk"), None,
          {"acceleration": 1300, "angular acceleration": 560}, ROLLING_START, always=False),
    Known("lieeuler", ("0",), ("DAE2H_LE", "INDEX1_LE"), ("heavy_top",), None, {"energy": 2.7}, UNSTABILIZED,
          practical=True),
)


def entries(run: Run, turning: Turning) -> tuple[Known, ...]:
    """The known defects that are about this run; `turning` is `crosscheck.adapters.turning`."""
    return tuple(entry for entry in KNOWN if entry.covers(run, turning))
