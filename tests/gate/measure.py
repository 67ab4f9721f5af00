"""How far engines are off: right ones from references of the same mechanics, wrong ones from their right twins."""

import sys
from pathlib import Path

import numpy as np

import crosscheck
from crosscheck.adapters.base import RunSpec
from tests.gate import right, wrong
from tests.gate.mechanics import Balls

# scene, step (s; of adaptive methods rtol), duration (s), samples, quantity: where the table's number was taken
CASES = {
    "Heun": ("double_pendulum", 0.01, 1, 6, "x"),
    "SymplecticEuler": ("hinge_pendulum", 0.01, 1, 6, "x"),
    "VerletMeans": ("hinge_pendulum", 0.01, 1, 6, "v"),
    "ChainedVerlet": ("torsion_wheel", 0.01, 1, 6, "w"),
    "DiscreteLagrange": ("hinge_pendulum", 0.01, 1, 6, "w"),
    "ImplicitMidpoint": ("axis_flip", 0.01, 1, 6, "R"),
    "Radau5": ("damped_pendulum", 0.02, 1, 6, "w"),
    "AdamsBashforth4": ("single_pendulum", 0.01, 1, 6, "x"),
    "RandomKutta3": ("single_pendulum", 0.01, 1, 6, "v"),
    "Adaptive5": ("double_pendulum", 1e-6, 1, 6, "w"),
    "SingleRK4": ("double_pendulum", 0.1, 1, 6, "x"),
    "BaumgarteRK4": ("rod_pendulum", 0.01, 1, 6, "R"),
    "ProjectedRK4": ("four_bar", 0.01, 1, 6, "w"),
    "Bouncing": ("bouncing_slide", 0.01, 2, 11, "x"),
    "Braked": ("braked_hinge", 0.01, 2, 11, "w"),
    "RotationVectors": ("heavy_top", 1e-3, 0.2, 5, "R"),
    "Extrapolated6": ("triple_pendulum", 0.04, 1, 6, "x"),
    "HalfTheStep": ("spring_pendulum", 0.02, 1, 6, "x"),
    "WorldMomenta": ("axis_flip", 0.01, 1, 6, "w"),
    "DenseRK4": ("single_pendulum", 0.015, 1, 6, "x"),
    "GravityTenThousandth": ("single_pendulum", 1e-3, 1, 11, "x"),
    "GravityTenMillionth": ("double_pendulum", 0.01, 2, 11, "x"),
    "InertiaOnePercent": ("double_pendulum", 0.01, 2, 11, "R"),
    "NoGyroscope": ("single_pendulum", 5e-3, 1, 11, "R"),
    "HalfStepRates": ("hinge_pendulum", 1e-3, 4, 101, "w"),
    "LateDamping": ("damped_pendulum", 0.02, 4, 101, "x"),
    "Jump": ("single_pendulum", 1e-3, 1, 11, "w"),
    "NaiveChart": ("heavy_top", 1e-3, 0.2, 21, "R"),
    "LinearOutput": ("single_pendulum", 3e-3, 1, 11, "x"),
    "LastStepsRates": ("single_pendulum", 2e-3, 1, 11, "v"),
    "WorldRates": ("axis_flip", 0.01, 2, 21, "w"),
    "DriftCalledHeld": ("rod_pendulum", 5e-3, 3, 101, "x"),
    "DoubleStep": ("hinge_pendulum", 1e-3, 4, 101, "x"),
    "EndMissed": ("single_pendulum", 1e-3, 1, 11, "x"),
    "HalfPrecision": ("single_pendulum", 4e-3, 1, 11, "v"),
    "StaleHistory": ("single_pendulum", 1e-3, 1, 11, "x"),
    "CoarseGrid": ("hinge_pendulum", 1e-3, 4, 101, "x"),
    "TunedStep": ("hinge_pendulum", 2e-3, 4, 101, "x"),
    "WarmBearing": ("torsion_wheel", 2e-3, 6, 121, "R"),
    "Noise": ("single_pendulum", 0.01, 1, 11, "x"),
    "LooseTolerance": ("double_pendulum", 1e-6, 2, 11, "R"),
    "LastStepsAccelerations": ("single_pendulum", 1e-3, 1, 11, "a"),
    "LateReversal": ("braked_hinge", 1e-3, 3, 61, "R"),
    "Restitution": ("bouncing_slide", 1e-3, 2, 41, "x"),
    "RestLength": ("spring_pendulum", 0.02, 4, 101, "x"),
    "TiltedAxis": ("hinge_pendulum", 2e-3, 4, 101, "x"),
    "BetweenOutputs": ("single_pendulum", 2e-3, 1, 21, "x"),
    "Reaction": ("heavy_top", 1e-3, 0.1, 11, "lam"),
    "Degrees": ("torsion_wheel", 2e-3, 6, 121, "R"),
    "Shadow": ("double_pendulum", 0.02, 10, 101, "w"),
}


def case(name):
    """Scene and step of a case."""
    scene, step, duration, samples, _ = CASES[name]
    own = Path(__file__).with_name("scenes") / f"{scene}.toml"
    return crosscheck.load_scene(own if own.exists() else scene).replace(duration=duration, samples=samples), step


def spec(cls, step):
    """The request."""
    return RunSpec(cls.__name__, rtol=step) if cls.adaptive_methods else RunSpec(cls.__name__, step=step)


def angle(A, B):
    """Angles between attitudes, rad."""
    R = np.einsum("tnji,tnjk->tnik", A, B)
    skew = [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]]
    return np.arctan2(0.5 * np.linalg.norm(skew, axis=0), 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1))


def differences(A, B):
    """The largest difference of each quantity over samples and bodies."""
    gaps = {k: angle(A[k], B[k]) if k == "R" else np.linalg.norm(A[k] - B[k], axis=-1) for k in A if k != "hinges"}
    return {k: float(np.max(gap)) for k, gap in gaps.items()}


def solve(rate, t0, t1, y, event=None):
    """DOP853 at 1e-13 from t0 to t1 or to the first event, with dense output."""
    from scipy.integrate import solve_ivp

    return solve_ivp(rate, (t0, t1), y, "DOP853", rtol=1e-13, atol=1e-14, dense_output=True, events=event)


def pieces(model, t, rate_of, event, after):
    """States at the times of a motion whose law changes at events."""
    out, y, now = [model.start], model.start, 0.0
    while len(out) < len(t):
        event.terminal = True
        event.direction = -1.0
        found = solve(rate_of(y), now, t[-1], y, event)
        out += [found.sol(s) for s in t[len(out):] if s <= found.t[-1] or found.status == 0]
        if found.status == 1:
            y, now = after(found.y[:, -1]), found.t[-1]
    return np.array(out)


def stopped(model, t):
    """The reference of a slide with a stop."""
    def hit(_t, y):
        return y[0] - model.lower + 1e-300

    return pieces(model, t, lambda y: model.rate, hit, lambda y: np.array([model.lower, -model.restitution * y[1]]))


def braked(model, t):
    """The reference of a hinge with dry friction that never sticks."""
    sign = [np.sign(model.start[1])]

    def slip(_y):
        return lambda _t, z: np.array([z[1], (model.torque(*z) - sign[0] * model.friction) / model.J])

    def turn(y):
        sign[0] = np.sign(model.torque(y[0], 0.0))
        return np.array([y[0], 0.0])

    return pieces(model, t, slip, lambda _t, y: sign[0] * y[1], turn)


def reference(cls, scene):
    """States at the outputs by SciPy."""
    model = cls().find(scene)[0]
    model = (Balls if issubclass(model, Balls) else model)(scene)
    if cls is right.Bouncing:
        return model.report(stopped(model, scene.t))
    if cls is right.Braked:
        return model.report(braked(model, scene.t))
    return model.report(solve(model.rate, 0.0, scene.t[-1], model.start).sol(scene.t).T)


def errors(cls, quantity):
    """Errors of a right engine at the step of its case, and at half of it (a hundredth of its tolerance)."""
    scene, step = case(cls.__name__)
    truth, finer = reference(cls, scene), step / (100 if cls.adaptive_methods else 2)
    return [differences(truth, cls().answer(scene, spec(cls, h)))[quantity] for h in (step, finer)]


def effects(cls):
    """Differences of a wrong engine from its right twin; of one with a memory, in its second run."""
    scene, step = case(cls.__name__)
    engine, twin = cls(), cls.__bases__[0]
    answer = engine.answer(scene, spec(cls, step))
    if cls is wrong.StaleHistory:
        answer = engine.answer(scene, spec(cls, step))
    return differences(answer, twin().answer(scene, spec(twin, step)))


def main():
    """The table's numbers."""
    for cls in (*right.RIGHT, *wrong.WRONG):
        if len(sys.argv) > 1 and cls.__name__ not in sys.argv[1:]:
            continue
        quantity = CASES[cls.__name__][-1]
        sizes = errors(cls, quantity) if cls in right.RIGHT else [effects(cls)[quantity]]
        print(cls.__name__, *CASES[cls.__name__], *[f"{size:.3e}" for size in sizes], flush=True)


if __name__ == "__main__":
    main()
