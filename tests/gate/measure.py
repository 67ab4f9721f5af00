"""How far engines are off: right ones from references of the same mechanics, wrong ones from their right twins."""

import csv
import sys
from pathlib import Path

import numpy as np

import crosscheck
from crosscheck.adapters.base import RunSpec
from tests.gate import right, wrong
from tests.gate.mechanics import Balls

with open(Path(__file__).with_name("table.csv"), newline="") as file:
    TABLE = {row["name"]: row for row in csv.DictReader(file)}
CASES = {name: (row["scene"], float(row["step"]), float(row["duration"]), int(row["samples"]), row["quantity"])
         for name, row in TABLE.items()}
"""Scene, step (s; of adaptive methods rtol), duration (s), samples, quantity: where the table's number was taken."""


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

    def turn(y):
        sign[0] = np.sign(model.torque(y[0], 0.0))
        return np.array([y[0], 0.0])

    return pieces(model, t, lambda _y: model.slipping(sign[0]), lambda _t, y: sign[0] * y[1], turn)


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
