"""Known defects of Exudyn."""

from crosscheck.adapters.common.known import CONTRADICTORY, SINGULAR
from crosscheck.document.known import ORDERS, Known

TREE_NEWTON = ("in joint coordinates Newton's iteration contracts slowly, 8 to 14 times a step on chain_64, and at "
               "larger steps not at all: it ends at 18 ms there with any tolerance from 1e-9 to 1e-6, with 200 "
               "iterations and with a numerical Jacobian; explicit methods run on the same model to their order")
NEWTON_NOISE = ("with 64 bodies the tightest tolerance at which Newton's iteration ends is 1e-9; a constraint left "
                "open by e is an error e / h of velocities, so that errors grow again below 0.2 ms. Above, second "
                "order shows: 3.8e-7, 9.5e-8, 2.4e-8 m at 0.8, 0.4, 0.2 ms")
AXIS_ROWS = ("velocity rows are components of the relative angular velocity, the derivatives of the position rows "
             "only where these are closed; an index-2 method leaves them open by a second-order drift, and so its "
             "velocities by the same: 1e-5, 2.5e-6, 6e-7 m/s at 2, 1, 0.5 ms. Rows of points lie along axes that turn "
             "with the first body: on squeezer v1 - v0 is w0 x (p1 - p0) to 1e-13, and p1 - p0 is up to 9e-8 m")
LIGHT_NODES = ("bodies of 1e-7 kg m^2 on Lie group nodes: Newton's residual of GeneralizedAlpha ends at 2e-7 N, which "
               "leaves .004, .012, .018 rad/s at 20, 5, 1.25 us; TrapezoidalIndex2 loses attitudes, 4.8e-7, 9.1e-7, "
               "5.5e-6 rad, whatever Newton's tolerance. Euler parameters and joint coordinates show order 2")
CARDAN = ("in joint coordinates a ball is three rotations; where the second comes near a right angle the others turn "
          "about almost one axis, the equations stiffen as the inverse square of its cosine, and steps of this length "
          "end the run; this motion comes to a cosine of 0.08 or less in every order of the axes")
ROLLING_START = ("the accelerations that Exudyn starts a rolling disk with lack gamma, the part of its rows that comes "
                 "from velocities: .43 m/s^2 on wobbling_disk, .79 on rolling_disk at any step. The trapezoidal rule "
                 "damps nothing and carries it on with alternating sign, 1.03 rad/s^2 after a step of rolling_disk, "
                 "3.49 after 3 s, which extrapolation does not cancel; GeneralizedAlpha loses a third of it a step, "
                 "and leaves 3e-11 rad an interval in place of 4e-8")

KNOWN = (
    Known(("1",), ("TrapezoidalIndex2",), ("double_four_bar",), None, {"run": 1.0}, SINGULAR, always=False),
    Known(("1",), ("TrapezoidalIndex2",), ("bricard",), None, {"level velocity": 6.6e6}, CONTRADICTORY),
    Known(("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("squeezer",), ("maximal",), {
        "order attitude": 3.2, "order angular velocity": 2.0, "order intervals": 2.5, "noise": 3.0,
        "limit attitude": 64, "limit velocity": 27, "limit angular velocity": 4.1e4},
        LIGHT_NODES, always=False),
    Known(("1",), ("TrapezoidalIndex2",), ("branching_tree", "driven_double_pendulum", "squeezer", "twisted_pair"),
          ("maximal",), {"level velocity": 3.7e5}, AXIS_ROWS),
    Known(("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("chain_64", "light_heavy"), ("tree",),
          dict.fromkeys(ORDERS, 0.0) | {"run": 1.0}, TREE_NEWTON, always=False),
    Known(("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("chain_64",), ("maximal",), {
        "order attitude": 2.9, "limit position": 12, "limit attitude": 590, "limit velocity": 180,
        "limit angular velocity": 940}, NEWTON_NOISE, always=False),
    Known(("1",), ("GeneralizedAlpha", "TrapezoidalIndex2", "RK44", "RK67", "DOPRI5"),
          ("thrown_double", "thrown_triple"), None, {
              "run": 1.0, "interval position": 130, "interval attitude": 160, "interval velocity": 850,
              "interval angular velocity": 1100}, CARDAN, always=False),
    Known(("1",), ("GeneralizedAlpha", "TrapezoidalIndex2"), ("rolling_disk", "wobbling_disk"), None,
          {"acceleration": 1300, "angular acceleration": 560}, ROLLING_START, always=False),
    Known(("1",), ("TrapezoidalIndex2",), ("rolling_disk",), None, {"interval attitude": 1.41}, ROLLING_START,
          always=False, margin=1.5),
)
