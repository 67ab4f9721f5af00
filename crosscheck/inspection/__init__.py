"""Static cross-check: compare what the engines say about a scene, without any stepping, with independent truth.

    found = inspect(scene, ["mujoco", "pinocchio"])
    found.agree, found.offenders, found.of("mujoco")
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Sequence
from typing import Any, overload

from crosscheck import adapters
from crosscheck.adapters import built_in
from crosscheck.adapters.base import RunSpec
from crosscheck.errors import EngineError, Unsupported, errors_as, install, named
from crosscheck.inspection import admissible, native
from crosscheck.inspection.base import Deviation, Inspection, Probe
from crosscheck.inspection.reference import deviations, reference
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models import is_model
from crosscheck.scene.states import States

__all__ = ["Deviation", "Inspection", "Probe", "inspect", "probe"]

_BUILT_IN = tuple(name for name in built_in.ENTRIES if importlib.util.find_spec(f"{__name__}.{name}"))
"""Engines that have a module in this package."""

RANDOM_STATES = 3


@overload
def inspect(scene: Scene, engines: Sequence[object] | None = None, form: str | None = None, count: int = RANDOM_STATES,
            seed: int = 0) -> Inspection: ...


@overload
def inspect(scene: str | os.PathLike[str], engines: Sequence[object] | None = None, form: str | None = None,
            count: int = RANDOM_STATES, seed: int = 0) -> Inspection | native.NativeInspection: ...


def inspect(scene: Scene | str | os.PathLike[str], engines: Sequence[Any] | None = None, form: str | None = None,
            count: int = RANDOM_STATES, seed: int = 0) -> Inspection | native.NativeInspection:
    """Probe engines at the start of a scene and at `count` random admissible states, and compare them with truth.

    For a model file (.xml, .urdf) this is the native check: every engine loads the file itself and is compared with the
    scene that `crosscheck` makes of the file. The result is then a `crosscheck.inspection.native.NativeInspection`.

    Parameters
    ----------
    scene : a Scene, the name of a scene, the path of a scene file, or the path of a model file
    engines : names or adapters; an adapter that is not built in needs a method `probe`; default: all built-in engines
    form : a model form; default: every form of the adapter that can model the scene
    count : number of random states besides the start
    seed : of the random states

    Raises
    ------
    ArgumentError, SceneError
        An engine is unknown, or the scene cannot be read. An engine that fails is named in `skipped` instead.
    """
    if not isinstance(scene, Scene):
        if is_model(scene):
            return native.inspect(scene, engines, count, seed)
        scene = as_scene(scene)
    at = admissible.states(scene, count, seed)
    truth = reference(scene, at)
    probes, skipped = [], {}
    for engine in _BUILT_IN if engines is None else engines:
        adapter = adapters.get(engine) if isinstance(engine, str) else engine
        forms = (form,) if form is not None else adapter.forms or (None,)
        for one in forms:
            try:
                probes.append(probe(adapter, scene, at, one))
            except (Unsupported, EngineError) as error:
                skipped[f"{adapter.name} {one}" if one else adapter.name] = str(error)
    every = [deviation for one in probes for deviation in deviations(scene, truth, one)]
    return Inspection(scene, at, truth.probe, tuple(probes), tuple(every), skipped)


def probe(adapter: Any, scene: Scene, at: States, form: str | None = None) -> Probe:
    """What one engine says about `scene` at the states `at`: calls `probe` of the adapter or of this package.

    Raises `Unsupported` if there is no such method or the engine cannot model the scene in this form, and `EngineError`
    if the engine fails.
    """
    own = adapter.probe
    if adapter.name in _BUILT_IN:
        own = importlib.import_module(f"crosscheck.inspection.{adapter.name}").probe
    reasons = [adapter.unsupported(scene, RunSpec(method, step=1e-3, form=form)) for method in adapter.methods]
    if None not in reasons:  # a form may be available for some methods only
        raise Unsupported(reasons[0])
    with errors_as(lambda error: EngineError(
            f"{adapter.name} cannot be imported: {error}; {install(adapter.name)}"
            if isinstance(error, ImportError) else f"{adapter.name}: {named(error)}")):
        answer: Probe = own(scene, at, form)
    return answer
