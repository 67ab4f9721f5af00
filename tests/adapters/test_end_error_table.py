"""The end-error table of the engine notes: an adapter that misses a figure has built another system.

End error: max over bodies of |x - x_ref| at the end, m. Figures of two digits, hence 10 %; below 1e-10 round-off of
the run and of the truth enters, hence a factor of 2.
"""

import numpy as np
import pytest

import crosscheck

A, B, C = "single_pendulum", "double_pendulum", "heavy_top"

EULER = {(A, 1000): 7.4e-2, (A, 10000): 7.0e-3, (B, 1000): 7.9e-1, (B, 10000): 5.4e-1}
ORDER_4 = {(A, 1000): 1.3e-7, (A, 10000): 1.5e-11, (B, 1000): 8.1e-5, (B, 10000): 1.3e-8}

TABLE = {
    ("mujoco", "Euler", "tree"): EULER,
    ("mujoco", "implicitfast", "tree"): EULER,
    ("mujoco", "RK4", "tree"): ORDER_4,
    ("pinocchio", "SymplecticEuler", "tree"): EULER,
    ("pinocchio", "RK4naive", "tree"): {(A, 1000): 1.6e-4, (A, 10000): 1.6e-6, (B, 1000): 9.9e-2, (B, 10000): 1.5e-3,
                                        (C, 1000): 5.75e-3},
    ("pinocchio", "RKMK4", "tree"): ORDER_4,
    ("exudyn", "GeneralizedAlpha", "maximal"): {(A, 1000): 5.1e-3, (A, 10000): 5.2e-5, (B, 1000): 1.8e-1},
    ("exudyn", "TrapezoidalIndex2", "maximal"): {(A, 1000): 2.9e-3, (A, 10000): 2.9e-5, (B, 1000): 2.9e-1},
    ("exudyn", "RK44", "pivot"): {(A, 1000): 1.3e-7, (A, 10000): 1.3e-11},
    ("exudyn", "RK67", "pivot"): {(A, 1000): 5.8e-12},
    ("exudyn", "RK44", "tree"): {(A, 1000): 9.9e-8, (A, 10000): 1.1e-11, (B, 1000): 1.5e-3},
    ("exudyn", "RK67", "tree"): {(A, 1000): 2.7e-12, (B, 1000): 1.4e-6},
}
ROWS = [(*mode, *case, figure) for mode, cases in TABLE.items() for case, figure in cases.items()]


@pytest.mark.parametrize(("engine", "method", "form", "name", "steps", "figure"), ROWS)
def test_end_error(engine: str, method: str, form: str, name: str, steps: int, figure: float) -> None:
    scene = crosscheck.load_scene(name)
    run = crosscheck.run(scene, engine, method, step=scene.duration / steps, form=form, monitor=False)
    error = np.linalg.norm(run.x[-1] - crosscheck.truth(scene).states.x[-1], axis=-1).max()
    assert run.steps == steps
    if figure < 1e-10:
        assert figure / 2 < error < 2 * figure
    else:
        assert error == pytest.approx(figure, rel=0.1)


def test_mujoco_discrete_is_its_euler_where_nothing_is_stiff() -> None:
    """Without damping, springs and constraints the discrete integrator's metric is M: the same step map."""
    scene = crosscheck.load_scene(B)
    first, second = (crosscheck.run(scene, "mujoco", method, step=0.01, duration=1.0, samples=11, monitor=False)
                     for method in ("discrete", "Euler"))
    # both round differently; 1e-13 over 100 steps is a few ulps each, times the growth of the scene
    assert np.abs(first.x - second.x).max() < 1e-13
