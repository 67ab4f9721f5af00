"""crosscheck: one multibody scene, many engines, every result measured against independent truth.

Importing this package costs nothing: engines, SciPy and plotting are loaded when a function first needs them.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "load_scene": ("crosscheck.scene_file", "load_scene"),
    "scenes": ("crosscheck.scene_file", "scene_names"),
    "run": ("crosscheck.running", "run"),
    "engines": ("crosscheck.engines", ""),
    "methods": ("crosscheck.engines", "methods"),
    "truth": ("crosscheck.running", "truth"),
    "assert_agree": ("crosscheck.agreement", "assert_agree"),
    "Trajectory": ("crosscheck.trajectory", "Trajectory"),
    "SceneError": ("crosscheck.errors", "SceneError"),
    "Unsupported": ("crosscheck.errors", "Unsupported"),
    "EngineError": ("crosscheck.errors", "EngineError"),
    "TruthError": ("crosscheck.references.base", "TruthError"),
    "ArgumentError": ("crosscheck.errors", "ArgumentError"),
}

__all__ = sorted(_HOMES)


# `crosscheck.engines` is a subpackage and, called, the tuple of engine names: the subpackage makes itself callable,
# because the import system binds it here whatever this function returns.
def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'crosscheck' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = importlib.import_module(module)
    if attribute:
        value = getattr(value, attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
