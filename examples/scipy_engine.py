"""SciPy's DOP853 as an engine: index-1 accelerations of the whole scene, attitudes by their matrices."""

import time

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.errors import EngineError
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import Monitor
from crosscheck.scene.states import States


class SciPy(Engine):
    """Adapter of `scipy.integrate.solve_ivp`."""

    name = "scipy"
    methods = ("DOP853",)
    adaptive_methods = ("DOP853",)  # these take rtol; step is required for every other method
    package = "scipy"  # whose version it is
    # nothing projects, so that no level is held: all three drift with the tolerance

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        if any(force.type == "torsional_spring" for force in scene.loads):
            return "the unwrapped angle of a torsional spring is not carried along"
        if spec.step is not None:
            return "DOP853 is adaptive here; give rtol"
        return None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        from scipy.integrate import solve_ivp  # heavy imports belong inside functions
        from scipy.spatial.transform import Rotation

        n = scene.n

        def unpack(y: np.ndarray) -> tuple[np.ndarray, ...]:  # (T, 18 n) -> x, R, v, w
            x, R, v, w = np.split(y, np.cumsum([3 * n, 9 * n, 3 * n]), axis=1)
            R = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_matrix()  # the nearest rotations: nothing else keeps them
            return x.reshape(-1, n, 3), R.reshape(-1, n, 3, 3), v.reshape(-1, n, 3), w.reshape(-1, n, 3)

        def rate(_t: float, y: np.ndarray) -> np.ndarray:
            x, R, v, w = unpack(y[None])
            a, alpha, _ = mechanics.index1(scene, x, R, v, w)
            spin = np.cross(R, w[..., None, :])  # R hat(w), row by row
            return np.concatenate([v.ravel(), spin.ravel(), a.ravel(), alpha.ravel()])

        rtol = spec.rtol or 1e-9
        start = np.concatenate([scene.x0.ravel(), scene.R0.ravel(), scene.v0.ravel(), scene.w0.ravel()])
        began = time.perf_counter()
        solved = solve_ivp(rate, (0.0, scene.duration), start, "DOP853", rtol=rtol, atol=1e-3 * rtol, dense_output=True)
        wall = time.perf_counter() - began
        if not solved.success:
            raise EngineError(solved.message)
        x, R, v, w = unpack(solved.sol(scene.t).T)
        a, alpha, lam = mechanics.index1(scene, x, R, v, w)
        maxima = None
        if spec.monitor:
            monitor = Monitor(scene)
            monitor.update(*unpack(solved.y.T))  # every accepted step, in order
            maxima = monitor.maxima()
        return RawRun(States(scene.t, x, R, v, w, a, alpha, lam), wall, len(solved.t) - 1, None, maxima=maxima,
                      stats={"evaluations": solved.nfev})
