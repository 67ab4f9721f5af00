"""Why an engine differs: hypotheses about its model and its stepping, tested on short black-box runs.

The engine is seen through `Engine.run` alone. Its limit for vanishing steps is compared with independent truth; where
they differ, the accelerations it shows on the scene and on copies of it are fitted by altered models; a cause is named
only if it leaves nothing but noise and no other one does. Orders, hidden steps and stabilisation are looked at apart.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.base import Engine
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.errors import ArgumentError, EngineError, Unsupported
from crosscheck.scene.model import Scene

if TYPE_CHECKING:
    from crosscheck.diagnosis.observe import Observation, Subject

__all__ = ["Evidence", "Explanation", "NamedCause", "explain"]

AGREES = 1e-8
"""Normalised: a limit nearer to truth than this agrees; scene files keep their joints no better."""


UNSURE = 1e-3
"""Normalised: where runs at finer steps leave more than this open, they settle on no limit that could be compared."""


def explain(scene: Scene | str | os.PathLike[str], engine: Any, method: str | None = None,
            form: str | None = None, step: float | None = None, **options: Any) -> Explanation:
    """Why an engine's motion differs from a scene's true one, if it does.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engine : a name, or an object with `name`, `methods`, `unsupported` and `run` (docs/adding-an-engine.md)
    method : default: the engine's last of the highest documented order
    form : model form; default: the engine's choice
    step : s; of the look at the whole run. Default: small against the fastest rate of the scene
    **options : coordinate_map, alpha, beta, softness, node, for engines that know them, as in `crosscheck.run`

    Raises
    ------
    ArgumentError, SceneError
        As `crosscheck.run`.
    Unsupported
        The engine cannot run the scene.
    EngineError
        It failed on the first short runs; its words.
    """
    from crosscheck.diagnosis import observe
    from crosscheck.scene import file as scene_file

    began = time.perf_counter()
    loaded = scene_file.as_scene(scene)
    subject = _subject(loaded, engine, method, form, options)
    reason = subject.unsupported(loaded, None if subject.order(loaded) is None else step or 1e-3)
    if reason is not None:
        raise Unsupported(f"{subject.engine.name} {subject.method} on scene {loaded.name!r}: {reason}")
    scale = observe.scale_of(loaded)
    try:
        first = observe.first_look(subject, loaded, scale)
    except observe.Silent as error:
        raise EngineError(f"{subject.engine.name} {subject.method} on scene {loaded.name!r}: {error}") from error
    answer = _judged(subject, first)
    if answer.outcome == "agrees":
        _looked_through(subject, first, loaded, step, answer)
    answer.seconds = time.perf_counter() - began
    return answer


def _subject(scene: Scene, engine: str | Engine, method: str | None, form: str | None,
             options: dict[str, Any]) -> Subject:
    from crosscheck import adapters
    from crosscheck.adapters.base import ENGINE_OPTIONS
    from crosscheck.diagnosis.observe import Subject
    from crosscheck.errors import unknown
    from crosscheck.running.methods import best_method

    adapter = adapters.get(engine) if isinstance(engine, str) else _completed(engine)
    chosen = best_method(adapter, scene) if method is None else method
    if chosen not in adapter.methods:
        raise ArgumentError(unknown(f"method of {adapter.name}", chosen, adapter.methods))
    given = tuple((name, value) for name, value in options.items() if value is not None)
    allowed = getattr(adapter, "options", ENGINE_OPTIONS)
    for name, _ in given:
        if name not in ENGINE_OPTIONS or name not in allowed:
            raise ArgumentError(f"{name}: {adapter.name} does not have this option; it has "
                                f"{', '.join(sorted(allowed)) or 'none'}")
    return Subject(adapter, chosen, form, given)


def _completed(engine: Any) -> Engine:
    """An engine given as an object, with defaults for what it leaves out."""
    from crosscheck.adapters.foreign.own import completed

    return completed(engine, type(engine).__name__, "not stated")


def _looked_through(subject: Subject, first: Observation, scene: Scene, step: float | None,
                    answer: Explanation) -> None:
    """Look at the whole run and at the noise of its states where the beginning agrees; alters the answer."""
    from crosscheck.diagnosis import of_model, of_output, of_run

    order = subject.order(scene)
    finest = None if order is None else first.scene.duration / (first.scene.samples - 1) / 64
    noisy = of_output.floor(subject, first, finest, None if order is not None else 1e-12)
    answer.tried += 2
    if noisy is not None:
        answer.causes.append(noisy)
        answer.evidence.append(Evidence(noisy.name, "numerics", None, None, "states at a fine step", noisy.magnitude,
                                        True))
        answer.outcome = "named"
        answer.sentence = _sentence(answer, [])
        return
    answer.window, late = of_run.diagnose(subject, scene, first.scale, step)
    if late is None:
        answer.sentence = _sentence(answer, [])
        return
    answer.evidence.append(late.evidence)
    answer.causes += late.causes
    unexplained = [] if late.causes else [late.text]
    seen = None if late.causes else of_run.observation(subject, scene, first.scale, late.time)
    if seen is not None:
        found = of_model.diagnose(subject, seen, alone=True)
        answer.evidence += found.evidence
        answer.tried += found.tried
        if found.causes and not found.unexplained:
            answer.causes += [NamedCause(cause.name, f"{cause.magnitude}, from about t = {late.time:.4g} s on",
                                         cause.mend) for cause in found.causes]
            unexplained = []
    answer.outcome = "unknown" if unexplained else "named"
    answer.sentence = _sentence(answer, unexplained)


def _judged(subject: Subject, first: Observation) -> Explanation:
    """Compare the limit with truth, look for causes of what differs, and check the altered model afresh."""
    from crosscheck.diagnosis import altered, fit, misreadings, of_model, of_stepping
    from crosscheck.diagnosis.physics import of_scene
    from crosscheck.references.maximal import Maximal

    scene, scale = first.scene, first.scale
    exact = scale.flat(Maximal(scene).run())
    deviation = float(np.abs(first.y - exact).max())
    answer = Explanation(scene.name, subject.engine.name, subject.method, subject.form, "agrees", "", [], [], [],
                         scene.duration, deviation, first.noise, documented_order=subject.order(scene))
    differs = deviation > max(AGREES, fit.EXPLAINED * first.noise)
    found = of_model.diagnose(subject, first) if differs else of_model.ModelFinding()
    physics = found.physics or of_scene(scene).replace(absent=found.absent)
    start = (scene.R0, scene.w0) if found.start is None else misreadings.misread(scene, *found.start)
    unexplained = list(found.unexplained)
    if not differs and first.noise > UNSURE:
        unexplained.append(f"runs at finer steps leave {first.noise:.1e} open: there is no limit to compare")
    if found.told:
        answer.causes, answer.evidence, answer.tried = found.causes, found.evidence, found.tried
        answer.outcome = "named"
        answer.sentence = _sentence(answer, [])
        return answer
    if differs and not found.causes and not unexplained:
        unexplained.append("the motion differs, but neither its start nor its accelerations do")
    if differs and found.causes and not unexplained and not found.soft:
        shown = found.reported.undo(first.states) if found.reported else first.states
        after = np.abs(scale.flat(shown) - scale.flat(altered.predict(scene, physics, *start)))
        if physics.absent is not None:
            after = np.delete(after, physics.absent, axis=1)
        answer.explained = float(after.max())
        # Magnitudes are fitted to accelerations, as sure as those are; over 1 / W that is a velocity.
        unsure = fit.EXPLAINED * of_model.accelerations(first)[1]
        if answer.explained > max(AGREES, 10 * fit.EXPLAINED * first.noise, unsure):
            unexplained.append(f"the altered model still differs by {answer.explained:.1e}")
    known = of_stepping.Known(physics, start, found.soft, found.reported.undo if found.reported else None)
    steps = of_stepping.diagnose(subject, first, known)
    answer.observed_order = steps.order
    answer.causes, answer.candidates = found.causes + steps.causes, found.candidates
    answer.evidence, answer.tried = found.evidence + steps.evidence, found.tried + steps.tried
    unexplained += steps.unexplained
    answer.outcome = "unknown" if unexplained else "named" if answer.causes else "agrees"
    answer.sentence = _sentence(answer, unexplained)
    return answer


def _sentence(answer: Explanation, unexplained: list[str]) -> str:
    who = f"{answer.engine} {answer.method} on {answer.scene}"
    if answer.outcome == "agrees":
        return (f"{who}: no difference beyond {max(answer.deviation or 0.0, answer.noise or 0.0):.1e} in the first "
                f"{answer.window:.3g} s")
    causes = " and ".join(f"{cause.name} ({cause.magnitude})" for cause in answer.causes)
    seen = f"; looked at: the first {answer.window:.3g} s"
    if answer.outcome == "named":
        return f"{who}: {causes}{seen}"
    text = f"{who}: unknown; {'; '.join(unexplained)}"
    text += f"; {answer.tried} hypotheses tried" if answer.tried else ""
    text += f"; each of these would do: {', '.join(answer.candidates)}" if answer.candidates else ""
    return text + (f"; what would explain a part of it: {causes}" if causes else "") + seen
