"""Why an engine differs: hypotheses about its model and its stepping, tested by short runs of the engine.

All that is known of the engine comes from `Engine.run`. Its limit for vanishing steps is compared with independent
truth. If they differ, altered models are fitted to its accelerations on the scene and on copies of it. A cause is named
only if it leaves nothing but noise and no other cause does. Order, hidden sub-steps and stabilisation have tests of
their own.
"""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine
from crosscheck.diagnosis import (
    altered,
    fit,
    misreadings,
    observe,
    of_laws,
    of_model,
    of_output,
    of_run,
    of_sensors,
    of_stepping,
    of_verdict,
    shown,
)
from crosscheck.diagnosis.models import of_scene
from crosscheck.diagnosis.observe import Observation, Subject
from crosscheck.diagnosis.of_output import Noise
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.document import Way
from crosscheck.errors import ArgumentError, EngineError, Unsupported, unknown
from crosscheck.running.arguments import best_method, engine_options
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene

__all__ = ["Evidence", "Explanation", "NamedCause", "explain"]

AGREES = 1e-8
"""Normalised distance from truth below which a limit agrees: scene files close their joints no better."""

UNSURE = 1e-3
"""Normalised error of a limit above which it cannot be compared: the runs do not converge."""


def explain(scene: Scene | str | os.PathLike[str], engine: Any, method: str | None = None,
            form: str | None = None, step: float | None = None, **options: Any) -> Explanation:
    """Why the motion of an engine differs from the true motion of a scene, if it does.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engine : a name, or an object with `name`, `methods`, `unsupported` and `run` (docs/adding-an-engine.md)
    method : default: the engine's last of the highest documented order
    form : model form; default: the engine's choice
    step : step (s) of the run over the whole scene; default: small against the fastest rate of the scene
    **options : coordinate_map, reduce, alpha, softness ..., for engines that have them, as in `crosscheck.run`

    Returns
    -------
    Explanation
        Its `sentence` has the answer, `causes` the named causes, and `evidence` what was tested.

    Raises
    ------
    ArgumentError, SceneError
        As in `crosscheck.run`.
    Unsupported
        The engine cannot run the scene.
    EngineError
        The engine failed on the first short runs. The message is its own.
    """
    began = time.perf_counter()
    loaded = scene_file.as_scene(scene)
    subject = _subject(loaded, engine, method, form, options)
    reason = subject.unsupported(loaded, None if subject.order(loaded) is None else step or 1e-3)
    if reason is not None:
        raise Unsupported(f"{subject.engine.name} {subject.way.method} on scene {loaded.name!r}: {reason}")
    if loaded.has_laws and (law := of_laws.diagnose(subject, loaded)) is not None:
        law.seconds = time.perf_counter() - began
        return law
    scale = observe.scale_of(loaded)
    noise = of_output.floor(subject, observe.window(loaded, scale), scale)
    try:
        first = observe.first_look(subject, loaded, scale, noise.size if noise else 0.0)
    except observe.Silent as error:
        raise EngineError(f"{subject.engine.name} {subject.way.method} on scene {loaded.name!r}: {error}") from error
    answer = _judged(subject, first, noise)
    if answer.outcome == "pass":
        _looked_through(subject, first, loaded, step, answer)
    if loaded.sensors:
        of_sensors.add(subject, loaded, first.scale, step, answer)
    if answer.outcome == "pass":
        of_verdict.add(subject, loaded, step, answer)
    answer.seconds = time.perf_counter() - began
    return answer


def _subject(scene: Scene, engine: str | Engine, method: str | None, form: str | None,
             options: dict[str, object]) -> Subject:
    adapter = adapters.get(engine)
    chosen = best_method(adapter, scene) if method is None else method
    if chosen not in adapter.methods:
        raise ArgumentError(unknown(f"method of {adapter.name}", chosen, adapter.methods))
    return Subject(adapter, Way.of(adapter.name, chosen, form=form, **engine_options(
        adapter.name, adapter, chosen, options)))


def _looked_through(subject: Subject, first: Observation, scene: Scene, step: float | None,
                    answer: Explanation) -> None:
    """Look at the whole run if its beginning agrees, and add what is found to `answer`."""
    answer.window, late = of_run.diagnose(subject, scene, first.scale, step)
    if late is None:
        answer.conclude([])
        return
    answer.evidence.append(late.evidence)
    answer.causes += late.causes
    unexplained = [] if late.causes else [late.text]
    seen = None if late.causes else of_run.observation(subject, scene, first.scale, late.until)
    if seen is not None:
        fitted = of_model.diagnose(subject, seen, alone=True)
        answer.evidence += fitted.evidence
        answer.tried += fitted.tried
        if fitted.causes and not fitted.unexplained:
            answer.causes += [NamedCause(cause.name, f"{cause.magnitude}, from about t = {late.time:.4g} s on",
                                         cause.mend) for cause in fitted.causes]
            unexplained = []
    answer.conclude(unexplained)


def _judged(subject: Subject, first: Observation, noise: Noise | None) -> Explanation:
    """Compare the limit with truth, look for causes of a difference, and compare the motion of the altered model."""
    scene, scale = first.scene, first.scale
    deviation = float(np.abs(first.y - scale.flat(observe.true_motion(scene))).max())
    answer = Explanation(scene.name, subject.engine.name, subject.way.method, subject.way.form, "pass", "", [], [],
                         [], scene.duration, deviation, first.noise, documented_order=subject.order(scene))
    if noise is not None:
        answer.causes += [noise.cause] if noise.cause else []
        name, text = ("precision floor", f"{noise.size:.1e}, as declared") if noise.cause is None else (
            noise.cause.name, noise.cause.magnitude)
        answer.evidence.append(Evidence(name, "numerics", None, None, "states at a fine step", text,
                                        noise.cause is not None))
        answer.tried += 1
        exact = scale.flat(observe.true_motion(scene))
        if deviation <= max(of_output.SPREAD * noise.size, fit.EXPLAINED * first.noise) or (
                noise.cause is not None and of_output.between_samples(first.y, exact) is not None):
            return answer.conclude([])
    differs = deviation > max(AGREES, fit.EXPLAINED * first.noise)
    if differs and (limited := of_stepping.limited(subject, first)) is not None:
        answer.causes.append(limited)
        return answer.conclude([])
    if differs and noise is not None and noise.cause is None and subject.order(scene) is not None:
        cause, evidence = of_stepping.adds_up(subject, scene, scale)
        answer.evidence.append(evidence)
        answer.tried += 1
        if cause is not None:  # it hides whatever is smaller
            answer.causes.append(cause)
            return answer.conclude([])
    fitted = of_model.diagnose(subject, first) if differs else of_model.ModelFinding()
    model = fitted.model or of_scene(scene, absent=fitted.absent)
    start = (scene.R0, scene.w0) if fitted.start is None else misreadings.misread(scene, *fitted.start)
    unexplained = list(fitted.unexplained)
    if first.noise > UNSURE and not fitted.causes:
        unexplained.append(f"runs at finer steps leave {first.noise:.1e} open: there is no limit to compare")
    answer.causes += fitted.causes
    answer.evidence += fitted.evidence
    answer.tried += fitted.tried
    if fitted.told:
        return answer.conclude([])
    if differs and not fitted.causes and not unexplained:
        unexplained.append("the motion differs, but neither its start nor its accelerations do")
    if differs and fitted.causes and not unexplained and not fitted.soft:
        meant = fitted.reported.undo(first.states) if fitted.reported else first.states
        after = np.abs(scale.flat(meant) - scale.flat(altered.predict(model, *start)))
        if fitted.absent is not None:
            after = np.delete(after, fitted.absent, axis=1)
        answer.explained = float(after.max())
        # Magnitudes are fitted to accelerations and as uncertain as these. Over the time 1 / W that is a velocity.
        unsure = fit.EXPLAINED * shown.accelerations(first)[1]
        if answer.explained > max(AGREES, 10 * fit.EXPLAINED * first.noise, unsure):
            unexplained.append(f"the altered model still differs by {answer.explained:.1e}")
        elif answer.explained > fit.CLEAR * deviation:
            unexplained.append(f"the altered model leaves {answer.explained / deviation:.0%} of the difference")
    known = of_stepping.Known(model, start, fitted.soft, fitted.reported.undo if fitted.reported else None,
                              fitted.absent, bool(fitted.causes))
    # Errors of the step cannot be distinguished from noise.
    steps = of_stepping.NumericsFinding() if noise else of_stepping.diagnose(subject, first, known)
    answer.observed_order = steps.order
    answer.causes += steps.causes
    answer.candidates = fitted.candidates
    answer.evidence += steps.evidence
    answer.tried += steps.tried
    if any(cause.name == "clamp" for cause in steps.causes):  # no accelerations belong to its kinks
        unexplained = []
    return answer.conclude(unexplained + steps.unexplained)
