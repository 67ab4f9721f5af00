"""Pinocchio without the interpreter: the adapter's own integrators over `aba`, compiled against the wheel's headers.

A fair row for timings on trees of ball joints. It needs a C++ compiler, and two minutes at its first use:

crosscheck study work-precision double_pendulum --engine lieeuler --engine examples/pinocchio_compiled.py:Compiled
"""

import ctypes
import hashlib
import importlib.metadata
import os
import subprocess
from pathlib import Path

import numpy as np

from crosscheck.adapters.common import lie_steppers, stepping, tree
from crosscheck.adapters.pinocchio import models
from crosscheck.errors import EngineError
from crosscheck.files import cache_folder

SOURCE = Path(__file__).with_suffix(".cpp")
FLAGS = ("-std=c++20", "-O3", "-fno-math-errno", "-DNDEBUG", "-shared", "-fPIC", "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
         "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
         "-DBOOST_FUSION_INVOKE_MAX_ARITY=12")  # Pinocchio's own definitions
TABLEAUX = {"RKMK4": lambda: lie_steppers.CLASSIC_4, "RKMK8": lie_steppers.dop853}


class Compiled:
    """Scenes whose joints are all spherical and form a tree, without forces but gravity."""

    name = "pinocchio_compiled"
    methods = ("SymplecticEuler", *TABLEAUX)
    orders = {"SymplecticEuler": 1, "RKMK4": 4, "RKMK8": 8}  # noqa: RUF012
    forms = ("tree",)

    def version(self):
        """Version of the package `pin` as installed."""
        return importlib.metadata.version("pin")

    def held_levels(self, scene, spec):
        """All three, because it uses joint coordinates."""
        return tree.LEVELS

    def unsupported(self, scene, spec):
        """Why it cannot run the scene; None if it can."""
        if scene.forces or any(joint.type != "spherical" for joint in scene.joints):
            return "it is compiled for ball joints and no force but gravity"
        return "it is compiled for trees" if models.decompose(scene, "tree")[2] else None

    def run(self, scene, spec):
        """Integrate by fixed steps; raises `EngineError` if the driver cannot be built or the run diverges."""
        model = models.build(scene, "tree")
        driver = Driver(model)
        h = stepping.fixed_step(scene, spec)[1]
        q, v = (np.ascontiguousarray(part) for part in model.initial_state())
        tableau = TABLEAUX.get(spec.method, lambda: None)()

        def advance(steps, stride):
            positions, velocities = np.empty((steps // stride, len(q))), np.empty((steps // stride, len(v)))
            for sample in range(len(positions)):
                driver.step(tableau, h, stride, q, v)
                positions[sample], velocities[sample] = q, v
            return positions, velocities

        raw = stepping.march(scene, spec, (q.copy(), v.copy()), advance, model.states, driver.accelerate)
        raw.form = "tree"
        return raw


class Driver:
    """The compiled model: plain numbers of a Pinocchio model of ball joints, handed to the shared library."""

    def __init__(self, model):
        inner = model.model
        joints = range(1, inner.njoints)
        placements, inertias = [inner.jointPlacements[j] for j in joints], [inner.inertias[j] for j in joints]
        parents = np.array([inner.parents[j] - 1 for j in joints], dtype=np.intc)
        numbers = [np.ascontiguousarray(values, dtype=float) for values in (
            [placement.rotation for placement in placements], [placement.translation for placement in placements],
            [inertia.mass for inertia in inertias], [inertia.lever for inertia in inertias],
            [inertia.inertia for inertia in inertias], inner.gravity.linear)]
        self._library = library()
        self._tree = ctypes.c_void_p(self._library.tree_new(len(parents), address(parents), *map(address, numbers)))

    def __del__(self):
        if hasattr(self, "_tree"):
            self._library.tree_delete(self._tree)

    def step(self, tableau, h, steps, q, v):
        """Make steps of `h` s from (q, v), in place."""
        if tableau is None:
            self._library.tree_euler(self._tree, ctypes.c_double(h), steps, address(q), address(v))
            return
        rows, weights = np.concatenate([np.asarray(row, dtype=float) for row in tableau[0]]), np.array(tableau[1])
        self._library.tree_munthe_kaas(self._tree, len(weights), address(rows), address(weights), ctypes.c_double(h),
                                       steps, address(q), address(v))

    def accelerate(self, t, q, v):
        """Joint accelerations of histories (T,), (T, nq), (T, nv); no joint is driven, so that t tells nothing."""
        a = np.empty_like(v)
        for row in range(len(v)):
            self._library.tree_accelerate(self._tree, address(q[row].copy()), address(v[row].copy()), address(a[row]))
        return a


def address(values):
    """Where an array's numbers are, for C."""
    return ctypes.c_void_p(values.ctypes.data)


def library():
    """The driver, built once for this source and this version of the package, and kept in the cache folder."""
    import pinocchio

    prefix = next(above for above in Path(pinocchio.__file__).parents if (above / "include" / "pinocchio").is_dir())
    text = SOURCE.read_bytes() + repr((FLAGS, str(prefix), importlib.metadata.version("pin"))).encode()
    built = cache_folder() / f"pinocchio-{hashlib.sha256(text).hexdigest()[:16]}.so"
    if not built.exists():
        built.parent.mkdir(parents=True, exist_ok=True)
        aside = built.with_suffix(f".{os.getpid()}")
        libraries = ["-L", prefix / "lib", f"-Wl,-rpath,{prefix / 'lib'}", "-lpinocchio_default"]
        headers = ["-I", prefix / "include", "-I", prefix / "include" / "eigen3"]
        made = subprocess.run([os.environ.get("CXX", "c++"), *FLAGS, *headers, SOURCE, "-o", aside, *libraries],
                              capture_output=True, text=True)
        if made.returncode:
            raise EngineError(f"{SOURCE.name} cannot be compiled: {made.stderr.strip()[-500:]}")
        os.replace(aside, built)
    found = ctypes.CDLL(str(built))
    found.tree_new.restype = ctypes.c_void_p
    return found
