"""Why an engine differs: hypotheses about its model and its stepping, tested by short runs of the engine.

All that is known of the engine comes from `Engine.run`. Its limit for vanishing steps is compared with independent
truth. If they differ, altered models are fitted to its accelerations on the scene and on copies of it. A cause is named
only if it leaves nothing but noise and no other cause does. Order, hidden sub-steps and stabilisation have tests of
their own.
"""

from __future__ import annotations

import dataclasses
import os
import time
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine
from crosscheck.diagnosis import (
    altered,
    copies,
    fit,
    observe,
    of_laws,
    of_model,
    of_output,
    of_run,
    of_sensors,
    of_stepping,
    of_verdict,
)
from crosscheck.diagnosis.observe import Observation, Subject
from crosscheck.diagnosis.of_model import Known
from crosscheck.diagnosis.of_output import Noise
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.document import Way
from crosscheck.errors import ArgumentError, EngineError, OutOfTime, Unsupported, unknown, within
from crosscheck.running.arguments import best_method, engine_options
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import ALLOWED_VIOLATION

__all__ = ["Evidence", "Explanation", "NamedCause", "explain"]

UNSURE = 1e-3
"""Normalised error of a limit above which it cannot be compared: the runs do not converge."""

PATIENCE = 60.0
"""Processor time (s) after which the answer is what is known so far."""


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
        Its `sentence` has the answer, `causes` the named causes, and `evidence` what was tested. After 60 s of
        processor time it is what is known so far.

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
    answer = Explanation(loaded.name, subject.engine.name, subject.way.method, subject.way.form, "pass", "", [], [], [],
                         loaded.duration, None, None, documented_order=subject.order(loaded))
    clock = adapters.clock(engine) if isinstance(engine, str) else time.process_time
    try:
        with within(PATIENCE, clock):
            _ask(subject, loaded, step, answer)
    except OutOfTime:
        answer.unexplained.append(f"{PATIENCE:g} s of processor time are over")
    answer.seconds = time.perf_counter() - began
    return answer.conclude()


def _subject(scene: Scene, engine: str | Engine, method: str | None, form: str | None,
             options: dict[str, object]) -> Subject:
    adapter = adapters.get(engine)
    chosen = best_method(adapter, scene) if method is None else method
    if chosen not in adapter.methods:
        raise ArgumentError(unknown(f"method of {adapter.name}", chosen, adapter.methods))
    return Subject(adapter, Way.of(adapter.name, chosen, form=form, **engine_options(
        adapter.name, adapter, chosen, options)))


def _ask(subject: Subject, scene: Scene, step: float | None, answer: Explanation) -> None:
    """Ask one question after the other, until the difference is explained."""
    if scene.has_laws and answer.ask(of_laws.diagnose, subject, scene, answer):
        return
    scale = observe.scale_of(scene)
    brief = observe.window(scene, scale)
    observe.true_motion(brief)  # without it there is no answer
    noise = answer.ask(of_output.floor, subject, brief, scale)
    try:
        first = observe.first_look(subject, scene, scale, noise.size if noise else 0.0)
    except observe.Silent as error:
        raise EngineError(f"{subject.engine.name} {subject.way.method} on scene {scene.name!r}: {error}") from error
    answer.window, answer.noise = first.scene.duration, first.noise
    answer.ask(_judge, subject, first, noise, answer)
    if answer.is_empty:
        answer.ask(_look_through, subject, first, scene, step, answer)
    if scene.sensors:
        answer.ask(of_sensors.add, subject, scene, first.scale, step, answer)
    if answer.is_empty:
        answer.ask(of_verdict.add, subject, scene, step, answer)


def _look_through(subject: Subject, first: Observation, scene: Scene, step: float | None, answer: Explanation) -> None:
    """Look at the whole run if its beginning agrees, and add what is found to `answer`."""
    answer.window, late = of_run.diagnose(subject, scene, first.scale, step)
    if late is None:
        return
    answer.evidence.append(late.evidence)
    answer.causes += late.causes
    seen = None if late.causes else answer.ask(of_run.observation, subject, scene, first.scale, late.until)
    if seen is not None:
        fitted = dataclasses.replace(answer, causes=[], candidates=[], unexplained=[])
        of_model.diagnose(subject, seen, fitted, alone=True)
        answer.tried = fitted.tried
        if not fitted.unexplained:
            answer.causes += [NamedCause(cause.name, f"{cause.magnitude}, from about t = {late.time:.4g} s on",
                                         cause.mend) for cause in fitted.causes]
    if not answer.causes:
        answer.unexplained.append(late.text)


def _judge(subject: Subject, first: Observation, noise: Noise | None, answer: Explanation) -> None:
    """Compare the limit with truth, look for causes of a difference, and compare the motion of the altered model."""
    scene, scale = first.scene, first.scale
    exact = scale.flat(observe.true_motion(scene))
    deviation = answer.deviation = float(np.abs(first.y - exact).max())
    if noise is not None:
        answer.causes += [noise.cause] if noise.cause else []
        name, text = ("precision floor", f"{noise.size:.1e}, as declared") if noise.cause is None else (
            noise.cause.name, noise.cause.magnitude)
        answer.evidence.append(Evidence(name, "numerics", None, None, "states at a fine step", text,
                                        noise.cause is not None))
        answer.tried += 1
        if deviation <= max(of_output.SPREAD * noise.size, fit.EXPLAINED * first.noise) or (
                noise.cause is not None and of_output.between_samples(first.y, exact) is not None):
            return
    known: Known | None = Known.of(scene)
    if deviation > max(ALLOWED_VIOLATION, fit.EXPLAINED * first.noise):
        if (limited := answer.ask(of_stepping.limited, subject, first)) is not None:
            answer.causes.append(limited)
            return
        if noise is not None and noise.cause is None and subject.order(scene) is not None and of_stepping.adds_up(
                subject, scene, scale, answer):
            return  # it hides whatever is smaller
        known = _model(subject, first, deviation, answer)
    elif first.noise > UNSURE:
        answer.unexplained.append(NO_LIMIT.format(first.noise))
    if known is not None and noise is None:  # errors of the step cannot be distinguished from noise
        of_stepping.diagnose(subject, first, known, answer)


NO_LIMIT = "runs at finer steps leave {:.1e} open: there is no limit to compare"


def _model(subject: Subject, first: Observation, deviation: float, answer: Explanation) -> Known | None:
    """The engine's model, if its motion is that of one, with the causes of its difference from the scene's."""
    scale, beside = first.scale, len(answer.causes)
    known = of_model.diagnose(subject, first, answer)
    if known is None:
        return None
    found = len(answer.causes) > beside
    if first.noise > UNSURE and not found:
        answer.unexplained.append(NO_LIMIT.format(first.noise))
    if not found and not answer.unexplained:
        answer.unexplained.append("the motion differs, but neither its start nor its accelerations do")
    if found and not answer.unexplained and not known.soft:
        meant = first.states if known.undo is None else known.undo(first.states)
        after = np.abs(scale.flat(meant) - scale.flat(altered.predict(known.model, first.scene.t, known.start)))
        if known.absent is not None:
            after = np.delete(after, known.absent, axis=1)
        answer.explained = float(after.max())
        # Magnitudes are fitted to accelerations and as uncertain as these. Over the time 1 / W that is a velocity.
        unsure = fit.EXPLAINED * copies.accelerations(first)[1]
        if answer.explained > max(ALLOWED_VIOLATION, 10 * fit.EXPLAINED * first.noise, unsure):
            answer.unexplained.append(f"the altered model still differs by {answer.explained:.1e}")
        elif answer.explained > fit.CLEAR * deviation:
            answer.unexplained.append(f"the altered model leaves {answer.explained / deviation:.0%} of the difference")
    return known
