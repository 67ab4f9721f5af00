"""One run: `crosscheck run`, `truth`, `judge` (a run of some other program), `explain` and `advise`."""

from __future__ import annotations

import contextlib
import csv
import functools
import math
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import annotate, complain, progress_bar, say
from crosscheck.cli.options import figure
from crosscheck.errors import ArgumentError, CrosscheckError, SceneError, Unsupported, counted, unknown
from crosscheck.files import cell, replacing

if TYPE_CHECKING:
    from crosscheck.document import Advice, Record
    from crosscheck.document.outcomes import Outcome
    from crosscheck.running.trajectory import Trajectory
    from crosscheck.scene.model import Scene
    from crosscheck.scene.states import States


@options.reads_models
def run(
    scene: options.SceneName,
    engine: Annotated[str, typer.Option(help="see `crosscheck list`")] = "lieeuler",
    method: Annotated[str | None, typer.Option(help="see `crosscheck list`; default: lieeuler's taylor, at rtol 1e-9")
                      ] = None,
    step: Annotated[float | None, typer.Option(help="fixed step, s")] = None,
    rtol: Annotated[float | None, typer.Option(help="relative tolerance of an adaptive method")] = None,
    csv_file: Annotated[str | None, typer.Option("--csv", help="file for the trajectory; - for the terminal")] = None,
    script: Annotated[bool, typer.Option("--script", help="instead, print a script that imports the engine and NumPy "
                                         "alone and prints the engine's error against truth (mujoco)")] = False,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="file for the script; default: the terminal")] = None,
    issue: options.Issue = None,
    form: Annotated[str | None, typer.Option(help=options.FORM + "the best for the scene")] = None,
    setting: options.Settings = None,
    samples: Annotated[int | None, typer.Option(help="number of output times; default: the scene's")] = None,
    duration: options.Duration = None,
    need: options.Need = 1.0,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Run one scene with one method of one engine; print its figures and verdict, or write its trajectory as CSV.

    Exit code 0: it passes or shows only known defects; 1: it fails or does not run; 3: its motion was not judged over
    all of its time, or the engine cannot model the scene.
    """
    from crosscheck import adapters
    from crosscheck.document.outcomes import EXIT_CODES
    from crosscheck.report.headline import assumptions, ending
    from crosscheck.running import arguments
    from crosscheck.verification import run as run_scene
    from crosscheck.verification.scene_truth import until_its_end

    if method is None:
        if engine == "lieeuler":
            method, rtol = "taylor", 1e-9 if step is None and rtol is None else rtol
        elif len(methods := adapters.get(engine).methods) > 1:
            raise ArgumentError(f"--method: {engine} has {', '.join(methods)}: name one of them")
        else:
            method, = methods
    named = {"form": form, "samples": samples, "duration": duration}
    given = {key: value for key, value in named.items() if value is not None} | options.settings(setting)
    if script or out is not None or issue is not None:
        from crosscheck.cli.models import write_script

        write_script(scene, engine, method, step, {
            **given, "rtol": rtol, "csv": csv_file}, reading, out, issue)
        return
    _check(engine, method)
    for name, value in (("step", step), ("rtol", rtol)):
        arguments.positive(name, value)
    prepared, ended = options.loaded(scene, reading), ""
    if duration is None:
        with progress_bar(f"truth of {prepared.name}"):
            prepared, ended = until_its_end(prepared, step)
    with _ending(), progress_bar(f"{engine} {method} runs {prepared.name}"):
        traj = run_scene(prepared, engine, method, step=step, rtol=rtol, **given)
    if csv_file is not None:
        write_csv(prepared, traj, csv_file)
    if csv_file != "-":
        with progress_bar(f"{engine} {method} has run, truth of {prepared.name}"):
            judged = traj.verdict(scene, need)
        say(_first_line(judged) + (f"; {ended}, and the run there; --duration goes on" if ended else ""))
        _print_run(traj.scene, traj, csv_file, step)
        if judged is not None:
            for each in assumptions([judged]):
                say(each)
            _print_errors(judged)
            _print_energy(judged, traj)
            if last := ending(judged, shlex.join(["crosscheck", *sys.argv[1:]])):
                (say if judged.outcome == "unresolved" else print)(last)  # a command is one line, to be copied
        raise typer.Exit(EXIT_CODES["unresolved" if judged is None else judged.outcome])


def _check(engine: str, method: str | None = None) -> None:
    """Refuse an engine that is not there, or a method that it does not have, before a model is read."""
    from crosscheck import adapters
    from crosscheck.running.provenance import need

    need([engine])
    known = adapters.methods(engine)
    if method is not None and method not in known:
        raise ArgumentError(unknown(f"method of {engine}", method, known))


@contextlib.contextmanager
def _ending() -> Iterator[None]:
    """Print the outcome of an engine that cannot model the scene or does not run, or without truth, and end with it."""
    from crosscheck.document import outcomes
    from crosscheck.document.outcomes import EXIT_CODES
    from crosscheck.references import TruthError

    try:
        yield
    except (ArgumentError, SceneError):
        raise
    except CrosscheckError as error:
        found: Outcome = ("unsupported" if isinstance(error, Unsupported) else
                          "unresolved" if isinstance(error, TruthError) else "error")
        mark = outcomes.code(found)
        complain(f"{found}: {error}" + (f" ({mark})" if mark else ""))
        raise typer.Exit(EXIT_CODES[found]) from error


def _first_line(judged: Record | None) -> str:
    """The outcome of a run, its own error against truth, the share of its time that was judged, and what decided."""
    from crosscheck.document import QUANTITIES
    from crosscheck.document.outcomes import percent
    from crosscheck.report.headline import clause

    if judged is None:
        return "unresolved: nothing was compared, because neither --step nor --rtol was given"
    sizes = [f"{name} {error.max:.2g} {error.unit}" for name, error in judged.errors.items()
             if name in QUANTITIES and error.max is not None]
    until = "" if judged.truth_ends is None else f" up to {judged.truth_ends:.3g} s, where it ends"
    off = f"error against truth{until}: {', '.join(sizes)}" if sizes else "compared with no truth"
    first = judged.worst
    judging = "" if judged.share is None or judged.message.startswith("resolved over") else (
        f"; resolved over {percent(judged.least_share)} of its {judged.duration:g} s")
    reason = judged.message or ("" if first is None or judged.outcome == "pass" else clause(judged))
    said = f"{judged.outcome}: {off}{judging}" + (f"; {reason}" if reason else "")
    return f"{said} ({mark})" if (mark := judged.code) else said


def _print_errors(judged: Record) -> None:
    """Each quantity's error, and how small an error of the model would have shown."""
    for name, error in judged.errors.items():
        visible = judged.resolution.get(name)
        shown = "" if visible is None else f"; a model error above {visible:.1e} of its size would have shown"
        say(f"{name} error against truth {error.max:.1e} {error.unit}, at t = {error.time:.4g} s{shown}")


def _print_energy(judged: Record, traj: Trajectory) -> None:
    if judged.energy_error is not None and math.isfinite(judged.energy_error):
        where = ("minus the work done, at the output times" if traj.scene.worked_on else
                 "every step" if traj.maxima else "at the output times")
        start = ("" if judged.energy_error_by_start is None else
                 f" ({judged.energy_error_by_start:.1e} of |E(0)|)")
        say(f"energy error {judged.energy_error:.1e} of the largest kinetic energy{start}, {where}")


def _print_run(scene: Scene, traj: Trajectory, csv_file: str | None, asked: float | None) -> None:
    used = traj.stats.get("step")
    say(f"{traj.engine} {traj.method}{f' ({traj.form})' if traj.form else ''}: {traj.steps} steps"
               + (f" of {used:.6g} s" if used else "") + f", {traj.wall_time:.3g} s of stepping, "
               f"{1e6 * traj.wall_time / max(1, traj.steps):.3g} us per step")
    if asked and used and used < asked * (1 - 1e-9):
        say(f"the step {asked:g} s does not divide the {traj.t[1] - traj.t[0]:g} s between two output times, and was "
            "shortened to the next one that does")
    for body, position in zip(scene.bodies, traj.x[-1], strict=True):
        say(f"{body.name}: x({traj.t[-1]:g} s) = ({', '.join(f'{value:.12g}' for value in position)}) m")
    levels = [(name, getattr(traj, f"constraint_{name}"), unit)
              for name, unit in (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2"))]
    shown = ", ".join(f"{name} {abs(series).max():.1e} {unit}" for name, series, unit in levels if series is not None)
    say(f"constraints, at the samples: {shown}; orthogonality {traj.orthogonality.max():.1e}")
    if redundant := traj.stats.get("redundant_rows"):
        say(f"{redundant} constraint rows depend on the others; the multipliers have least norm")
    if spun := traj.stats.get("spin_free"):
        say(f"the spin of {', '.join(spun)} about its axis of symmetry is exact; --set spin_free=false steps it")
    if (reduced := traj.stats.get("reduce", "off")) != "off":
        say(f"stepped in fewer coordinates ({reduced}); --set reduce=off steps all")
    if csv_file is not None:
        typer.echo(f"written: {csv_file}")


@options.reads_models
def truth(
    scene: options.SceneName,
    csv_file: Annotated[str | None, typer.Option("--csv", help="file for the states; - for the terminal")] = None,
    reading: options.Reading = options.AS_IT_IS,
    floor: Annotated[bool, typer.Option(
        "--floor", help="also print the error that double precision leaves to any method")] = False,
) -> None:
    """Print the truth of a scene, a reference solution: its error, until when it holds, its end state."""
    import numpy as np

    from crosscheck.compare.errors import up_to
    from crosscheck.references import Chaotic, conditioning
    from crosscheck.running.run import truth as truth_of

    shown = options.loaded(scene, reading)
    try:
        with progress_bar(f"truth of {shown.name} by two formulations"):
            reference = truth_of(shown)
    except Chaotic as error:
        typer.echo(f"{error}. The following is the truth up to that time.", err=True)
        shown = shown.replace(duration=float(f"{error.horizon:.2e}") * 0.99, samples=min(shown.samples, 51))
        reference = truth_of(shown)
    if csv_file is not None:
        write_csv(shown, reference.states, csv_file)
    if csv_file == "-":
        return
    say(f"{shown.name}: {reference.source}")
    say(f"checked against: {reference.second_source}")
    say(f"error of this truth: at most {reference.error:.1e} of the scene's length; the two differ by "
        f"{reference.disagreement:.1e} (rounding explains up to {reference.allowed:.1e})")
    say(f"a perturbation grows {reference.amplification:.3g}-fold over {shown.duration:g} s; "
        f"runs are compared with truth up to {reference.horizon:g} s"
        + (f", where it ends: {reference.horizon_cause}" if reference.horizon_cause else ""))
    if floor:
        left, when = conditioning.floor(shown)
        say(f"floor of double precision: {left:.1e} of the length, radians; a rounding at {when:g} s grows most")
    last = int(np.count_nonzero(up_to(reference.t, reference.horizon))) - 1
    for body, position in zip(shown.bodies, reference.states.x[last], strict=True):
        say(f"{body.name}: x({reference.t[last]:g} s) = ({', '.join(f'{value:.15g}' for value in position)}) m")


def write_csv(scene: Scene, states: Trajectory | States, target: str) -> None:
    """Write states as CSV, one line per output time, in full precision; `target` is a path, or - for the terminal."""
    from crosscheck.scene.sensors import columns, unit
    from crosscheck.scene.states import COLUMNS

    header = ["t [s]"]
    for body in scene.bodies:
        header += [f"{body.name} {name}{f' [{of}]' if of else ''}" for names, of in COLUMNS.values() for name in names]
    extra = {"kinetic_energy": "kinetic energy [J]", "potential_energy": "potential energy [J]",
             "energy": "energy [J]", "constraint_position": "constraint position",
             "constraint_velocity": "constraint velocity", "constraint_acceleration": "constraint acceleration",
             "orthogonality": "orthogonality"}
    series = {title: getattr(states, name) for name, title in extra.items() if getattr(states, name, None) is not None}
    units = {sensor.name: unit(scene, sensor) for sensor in scene.sensors}
    read = getattr(states, "sensors", None) or {}
    series |= {f"{column} [{units[name]}]": values for name in read
               for column, values in columns({name: read[name]}).items()}
    with _stream(target) as stream:
        writer = csv.writer(stream)
        writer.writerow([cell(title) for title in (*header, *series)])
        for k, time in enumerate(states.t):
            row = [time]
            for i in range(scene.n):
                row += [value for field in COLUMNS for value in getattr(states, field)[k, i].ravel()]
            writer.writerow([repr(float(value)) for value in [*row, *(values[k] for values in series.values())]])


@contextlib.contextmanager
def _stream(target: str) -> Iterator[IO[str]]:
    """The terminal, a file that appears when it is complete, or an existing pipe or device."""
    if target == "-":
        yield sys.stdout
        return
    path = Path(target)
    whole = contextlib.nullcontext(path) if path.exists() and not path.is_file() else replacing(path)
    try:
        with whole as aside, open(aside, "w", newline="", encoding="utf-8") as stream:
            yield stream
    except OSError as error:
        raise ArgumentError(f"--csv {target}: cannot be written ({error.strerror})") from None


@options.reads_models
def judge(
    scene: options.SceneName,
    files: Annotated[list[Path], typer.Argument(
        help="logs, .csv, .sto, .mot, .npz or .parquet; with --step they are one run, each at another step")],
    columns: Annotated[Path | None, typer.Option(
        help="TOML file with names and units of the columns; --suggest prints one")] = None,
    suggest: Annotated[bool, typer.Option(
        "--suggest", help="print a file for --columns, with the names recognised")] = False,
    start: Annotated[str | None, typer.Option(
        help="scene: truth starts as the scene does; recorded: from the first row; either: from the first row where "
             "that is elsewhere, as of a model file without --qpos or --keyframe")] = None,
    tol: Annotated[list[str] | None, typer.Option(
        help="allowed error, such as joint_position=1e-3 (SI); may be repeated")] = None,
    step: Annotated[list[float] | None, typer.Option(
        help="s, with which a file was made; once for each file, in their order")] = None,
    order: Annotated[int | None, typer.Option(help="order of accuracy that the simulator should have")] = None,
    period: Annotated[float | None, typer.Option(help="s between two rows, for files without times")] = None,
    probes: Annotated[Path | None, typer.Option(
        help="folder of initial states for the simulator that made the file, and of its runs from these")] = None,
    need: Annotated[float, typer.Option(min=0.0, max=1.0, help=(
        "share of a log's time that has to be judged for it to pass"))] = 1.0,
    uncertain: Annotated[list[str] | None, typer.Option(help="logs with inputs: what is uncertain in the model, as "
                                                        "mass=5% or delay=2e-3 (SI); may be repeated")] = None,
    model: Annotated[str | None, typer.Option(help="logs with inputs: another model, to be compared")] = None,
    resolution: Annotated[float | None, typer.Option(help="logs with inputs: twice u_val over the travel of a joint, "
                                                     "above which nothing passes; default: .01")] = None,
    form: options.Format = "text",
    as_json: options.AsJson = False,
    out: Annotated[Path | None, typer.Option(
        "-o", "--out", help="folder of pages, errors over time as CSV, and JUnit's XML")] = None,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Judge logs of any simulator: how far each is from the scene's true motion, since when, and why.

    Exit code 0: within the tolerances; 1: not; 2: a file cannot be read; 3: unresolved (truth ends earlier, digits are
    too coarse, no --tol), and what to change.
    """
    from crosscheck import recordings
    from crosscheck.document import outcomes
    from crosscheck.scene.models import import_model, is_model

    allowed = dict(options.named_number("--tol", each, "position=1e-3") for each in tol or ())
    if allowed and (sensors := options.sensors(scene)) is not None:  # before a model is read
        recordings.tolerances(sensors, allowed)
    described = options.loaded(scene, reading)
    own = is_model(scene) and not any(reading.start.values())  # without a start of its own
    start = start or ("either" if own else "scene")
    import_at = functools.partial(import_model, scene, **reading.given) if own else None
    if suggest:
        typer.echo(recordings.suggest(files[0], described, period), nl=False)
        return
    unsure = dict(options.named_number("--uncertain", each.replace("%", "e-2"), "mass=5%") for each in uncertain or ())
    beside = None if model is None else options.loaded(model, reading)
    if probes is not None:
        raise typer.Exit(_judge_probes(described, files, probes, step or [], order))
    runs: list[Any] = [list(files) if len(files) > 1 else files[0]] if step else list(files)
    verdicts = {}
    for given in runs:
        name = str(given if not step else files[0])
        with progress_bar(f"judging {name}: truth, errors, causes") as progress:
            verdicts[name] = recordings.judge_recording(
                described, given, columns, start, allowed or None, step or None, order, progress, period, need,
                unsure or None, beside, resolution, import_at)
    if out is not None:
        recordings.write_all(verdicts, out)
    if as_json:
        plain = {name: verdict.plain() for name, verdict in verdicts.items()}
        options.print_json(plain if len(plain) > 1 else next(iter(plain.values())))
    elif len(verdicts) == 1:
        for line in next(iter(verdicts.values())).lines:
            say(line)
    else:
        for name, verdict in verdicts.items():
            say(f"{verdict.lines[0].partition(':')[0]}: {name}: {verdict.why}")
    command_line = shlex.join(["crosscheck", *sys.argv[1:]])
    if any(verdict.outcome == "fail" for verdict in verdicts.values()) and not as_json:
        print(f"reproduce: {command_line}")
    for name, verdict in verdicts.items() if form == "github" else ():
        if verdict.code:
            annotate(verdict.outcome, f"{verdict.code} {name}", f"{verdict.why}; {command_line}")
    if out is not None and not as_json:
        print(f"page: {out / 'index.html'}" if len(verdicts) == 1 else f"pages: {out}")
    raise typer.Exit(outcomes.exit_code(verdict.outcome for verdict in verdicts.values()))


def _judge_probes(scene: Scene, files: list[Path], folder: Path, step: list[float], order: int | None) -> int:
    """The exit code of a verdict on a simulator that is known by its files."""
    from crosscheck.document.outcomes import EXIT_CODES
    from crosscheck.verification.probing import judge_probes

    if len(files) != 1 or len(step) != 1 or order is None:
        raise ArgumentError("--probes: one file of states, its --step and the --order of the simulator are wanted")
    record, open_ = judge_probes(scene, files[0], folder, step[0], order)
    if record is not None:
        say(_first_line(record))
        _print_errors(record)
    if open_:
        say(f"{counted(len(open_), 'question')} open: run the simulator on the scenes in {folder}, each at the step "
            f"that questions.csv gives, write the states beside them, and give this command again")
    return 3 if record is None else EXIT_CODES[record.outcome]


@options.reads_models
def explain(
    scene: options.SceneName,
    engine: Annotated[str, typer.Option(help="a name, or a class of your own as module:Class")],
    method: Annotated[str | None, typer.Option(help="default: the engine's best")] = None,
    form: Annotated[str | None, typer.Option(help=options.FORM + "the engine's choice")] = None,
    step: Annotated[float | None, typer.Option(help="s, of the whole run; default: one that suits the scene")] = None,
    setting: options.Settings = None,
    as_json: options.AsJson = False,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Name the likely cause of an engine's difference from truth, with the evidence.

    Exit code 0: no difference; 1: a cause is named; 3: it differs, and the cause is unknown.
    """
    from crosscheck.diagnosis import explain as explain_run

    _check(engine, method)
    described = options.loaded(scene, reading)
    with _ending(), progress_bar(f"causes for {engine} on {scene}"):
        answer = explain_run(described, engine, method, form, step, **options.settings(setting))
    if as_json:
        options.print_json(answer.plain())
    else:
        _print_cause(answer)
    raise typer.Exit(answer.exit_code)


def _print_cause(answer: Any) -> None:
    """Print the verdict, the measured difference, the evidence, and what to change."""
    mark = {"pass": "✓", "fail": "✗", "unresolved": "?"}[answer.outcome]
    say(f"{mark} {answer.sentence}" + (f" ({answer.code})" if answer.code else ""))
    say(f"difference from truth as steps vanish: {figure(answer.deviation, '–')}, known to {figure(answer.noise, '–')} "
        f"(the largest of |dx|/L, |dR|, |dv|/(L W) and |dw|/W in the first {answer.window:.3g} s, where L is the "
        "longest lever and W the fastest rate of the scene)")
    if answer.explained is not None:
        say(f"left of it once truth has the cause too: {answer.explained:.1e}")
    if answer.documented_order is not None:
        observed = "at rounding" if answer.observed_order is None else f"{answer.observed_order:.2f}"
        say(f"observed order: {observed}, documented {answer.documented_order}")
    if answer.evidence:
        say(f"evidence; hypotheses tried: {answer.tried} (✓ explains, · does not)")
    for each in answer.evidence:
        parts = [f"{each.quantity}: {figure(each.before, '–')} without, {figure(each.after, '–')} with it",
                each.magnitude, each.note]
        say(f"{'✓' if each.holds else '·'} {each.hypothesis}; {'; '.join(filter(None, parts))}", indent=2)
    for cause in answer.causes:
        say(f"what to change: {cause.mend} ({cause.name})")
    if answer.outcome == "fail":
        print(f"reproduce: {shlex.join(['crosscheck', *sys.argv[1:]])}")
    elif answer.ending:
        say(answer.ending)


@options.reads_models
def advise(
    scene: options.SceneName,
    engine: Annotated[str, typer.Option(help="a name, name==version, or a class of your own as module:Class")],
    error: Annotated[list[str], typer.Option(help="largest error of position, attitude and both velocities, each over "
                                             "its size; or position=1e-4 in SI, which may be repeated")],
    as_json: options.AsJson = False,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Find the cheapest method of an engine for an error, its largest step, and the step at which it fails.

    Where the scene has friction, stops or servos, also: does the engine converge, to which law, and how far is that
    from the scene's.

    It compares runs with truth, for at most half a minute of processor time, and keeps them for later calls. Exit code
    0: a method reaches the error; 3: none within the budget.
    """
    import msgspec
    from msgspec.structs import replace

    from crosscheck.document.outcomes import EXIT_CODES
    from crosscheck.verification.advice import advise as advice_for

    wanted = _wanted(error)
    _check(engine)
    loaded = options.loaded(scene, reading)
    with progress_bar(f"runs of {engine} at a series of steps, against truth"), _ending():
        advice = advice_for(loaded, engine=engine, error=wanted)
    if advice.command is not None:
        given = shlex.join([scene, *reading.words])
        advice = replace(advice, command=advice.command.replace(
            f"run {shlex.quote(loaded.name)} ", f"run {given} ", 1))
    with progress_bar(f"to which law {engine} converges, at four steps"):
        law = _law(loaded, engine, advice)
    if as_json:
        options.print_json({**msgspec.to_builtins(advice), "law": law})
    else:
        print_advice(advice)
        for line in (law or "").splitlines():
            say(f"law      {line}", hang=9)
    raise typer.Exit(EXIT_CODES["unresolved" if advice.method is None else "pass"])


def _wanted(error: list[str]) -> float | dict[str, float]:
    """The error of `advise`, or errors by quantity."""
    if len(error) == 1 and "=" not in error[0]:
        try:
            return float(error[0])
        except ValueError:
            raise ArgumentError(f"--error: {error[0]!r} is no number; give one, such as 1e-6, of the size of each "
                                "quantity, or position=1e-4, in m") from None
    return {name.replace("_", " "): value for name, value in (
        options.named_number("--error", each, "position=1e-4") for each in error)}


def _law(scene: Scene, engine: str, advice: Advice) -> str | None:
    """The three answers about the scene's laws by the advised method, or the engine's own choice where its step is not
    fixed, as long as truth is known; None for a scene without laws."""
    from crosscheck import adapters
    from crosscheck.diagnosis.laws import which_law

    if not scene.has_laws:
        return None
    samples = 1 + round(advice.until / scene.duration * (scene.samples - 1))
    scene = scene.replace(duration=advice.until, samples=samples)
    method, form = (advice.method, advice.form) if advice.step else (None, None)
    try:
        answers = str(which_law(scene, engine, method, advice.step, form=form))
        soft = "softness" in adapters.get(engine).options
        return f"the lines above are for softness=tight; by itself: {answers}" if soft else answers
    except Unsupported as error:
        return str(error)


def print_advice(each: Advice) -> None:
    """Print an advice; the line of the command is not folded, so that it can be copied."""
    for line in words(each):
        if line.startswith("command "):
            print(line)
        else:
            say(line, hang=9)


def words(each: Advice) -> list[str]:
    """The lines of an advice."""
    from crosscheck.document import QUANTITIES

    wanted = (f"every error at most {each.wanted:g} of its size" if isinstance(each.wanted, float) else ", ".join(
        f"{name} error at most {value:g} {QUANTITIES[name]}" for name, value in each.wanted.items()))
    ends = f", where truth ends: {each.ended}" if each.ended else ""
    asked = f"{each.scene} with {each.engine}, {wanted}, up to {each.until:g} s{ends}"
    if each.method is None:
        least = "no run ended" if each.least is None else f"the least error found is {each.least:.1e} of its size"
        return [f"unresolved: {asked}: not {each.tried}; {least}"]
    size = f"step     {each.size}" if each.step else f"rtol     {each.size.removeprefix('rtol ')}"
    fails = "at no step tried; the coarsest is the time between two outputs" if each.breaks_at is None else (
        f"at {'step' if each.step else 'rtol'} {figure(each.breaks_at)}{' s' if each.step else ''}: it does not "
        "end, or a quantity is wrong by a tenth of its size")
    errors = ", ".join(f"{name} {value:.1e} {QUANTITIES[name]}" for name, value in each.errors.items())
    return [asked, f"method   {each.method}{f', form {each.form}' if each.form else ''}", size,
            f"error    {errors}" if isinstance(each.wanted, dict) else
            f"error    {each.error:.1e} of the size of a quantity{f' ({errors})' if errors else ''}",
            f"cost     {each.cost or 0.0:.3g} s of computing for {each.until:g} s",
            f"fails    {fails}", f"command  {each.command}"]
