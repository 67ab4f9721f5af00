"""What the public names are, for type checkers; at run time crosscheck/__init__.py loads them when they are needed."""

from crosscheck.adapters import methods
from crosscheck.adapters import names as engines
from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.export import export_model
from crosscheck.diagnosis import explain
from crosscheck.diagnosis.laws import which_law
from crosscheck.errors import ArgumentError, CrosscheckError, EngineError, SceneError, Unsupported
from crosscheck.inspection import inspect
from crosscheck.inspection.diff import diff
from crosscheck.jointspace.derivatives import derivatives
from crosscheck.jointspace.flows import flow_derivative
from crosscheck.jointspace.inverse import inverse_dynamics
from crosscheck.jointspace.modes import modes
from crosscheck.recordings import assert_recording, judge_recording
from crosscheck.references.base import TruthError
from crosscheck.running.run import truth
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.file import load_scene
from crosscheck.scene.file import scene_names as scenes
from crosscheck.scene.model import Scene
from crosscheck.scene.models import import_model
from crosscheck.scene.states import States
from crosscheck.sweeps.job import sweep
from crosscheck.testing.agreement import assert_agree
from crosscheck.verification import run
from crosscheck.verification.advice import advise
from crosscheck.verification.verified import verify

__version__: str

__all__ = [
    "ArgumentError", "CrosscheckError", "EngineError", "RawRun", "RunSpec", "Scene", "SceneError", "States",
    "Trajectory", "TruthError", "Unsupported", "advise", "assert_agree", "assert_recording", "derivatives", "diff",
    "engines", "explain", "export_model", "flow_derivative", "import_model", "inspect", "inverse_dynamics",
    "judge_recording", "load_scene", "methods", "modes", "run", "scenes", "sweep", "truth", "verify", "which_law",
]
