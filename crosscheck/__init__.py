"""crosscheck: one multibody scene, many engines, every result measured against independent truth.

Importing this package is fast: engines, SciPy and plotting are imported when a function first needs them.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "load_scene": ("scene.file", "load_scene"),
    "export_model": ("adapters.export", "export_model"),
    "import_model": ("scene.models", "import_model"),
    "scenes": ("scene.file", "scene_names"),
    "run": ("verification", "run"),
    "engines": ("adapters", "names"),
    "methods": ("adapters", "methods"),
    "truth": ("running.run", "truth"),
    "verify": ("verification.verified", "verify"),
    "advise": ("verification.advice", "advise"),
    "explain": ("diagnosis", "explain"),
    "which_law": ("diagnosis.laws", "which_law"),
    "inspect": ("inspection", "inspect"),
    "diff": ("inspection.diff", "diff"),
    "inverse_dynamics": ("jointspace.inverse", "inverse_dynamics"),
    "derivatives": ("jointspace.derivatives", "derivatives"),
    "flow_derivative": ("jointspace.flows", "flow_derivative"),
    "modes": ("jointspace.modes", "modes"),
    "sweep": ("sweeps.job", "sweep"),
    "judge_recording": ("recordings", "judge_recording"),
    "assert_recording": ("recordings", "assert_recording"),
    "assert_agree": ("testing.agreement", "assert_agree"),
    "Scene": ("scene.model", "Scene"),
    "States": ("scene.states", "States"),
    "Trajectory": ("running.trajectory", "Trajectory"),
    "RunSpec": ("adapters.base", "RunSpec"),
    "RawRun": ("adapters.base", "RawRun"),
    "SceneError": ("errors", "SceneError"),
    "Unsupported": ("errors", "Unsupported"),
    "EngineError": ("errors", "EngineError"),
    "TruthError": ("references.base", "TruthError"),
    "ArgumentError": ("errors", "ArgumentError"),
    "CrosscheckError": ("errors", "CrosscheckError"),
}
"""The public names, each with its module and its attribute there."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("lieeuler-crosscheck")
    if name not in _HOMES:
        raise AttributeError(f"module 'crosscheck' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(importlib.import_module(f"crosscheck.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
