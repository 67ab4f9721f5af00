"""`crosscheck study`: measurements over many runs, each for one question."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, figures, key, print_table, progress_bar, say, words
from crosscheck.cli.options import Engines, chosen, figure
from crosscheck.cli.options import figures as shown
from crosscheck.errors import counted
from crosscheck.studies import study as studies
from crosscheck.studies.chaos import ChaosAsk, ChaosStudy
from crosscheck.studies.drift import DriftAsk, DriftStudy
from crosscheck.studies.stability import Stability, StabilityAsk
from crosscheck.studies.study import Ask, Study, StudyDocument
from crosscheck.studies.work_precision import FRONTIERS, WorkPrecision, WorkPrecisionAsk

Asked = TypeVar("Asked", bound=Ask)
Doc = TypeVar("Doc", bound=StudyDocument)

app = typer.Typer(name="study", no_args_is_help=True, add_completion=False)

SHOWN = (1, 4, 7)
"""Indices of the error levels in the table of all methods, see `crosscheck.studies.work_precision.LEVELS`."""

Names = list[str] | None
Step = Annotated[float, typer.Option(min=1e-9, help="s; powers of 2, such as the default, add up without rounding")]
Out = Annotated[Path, typer.Option("--out", "-o", help="folder of the page, JSON and CSV")]


@app.callback()
def alone() -> None:
    """Work against precision, drift over long runs, largest usable steps, chaos."""


def _conduct(study: Study[Asked, Any, Doc], ask: Asked, out: Path) -> Doc:
    """Run a study with a progress bar; returns its document."""
    with progress_bar() as progress:
        return studies.conduct(study, ask, out, progress)


def _tell_page(out: Path) -> None:
    typer.echo(f"page: {out / 'index.html'}")


@app.command("work-precision")
def work_precision(
    scene: Annotated[Names, options.scenes("single_pendulum double_pendulum heavy_top")] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("all")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="interleaved rounds; their medians count")] = 5,
    time_limit: Annotated[float, options.time_limit("stepping only; longer rungs are left out")] = 1.0,
    bound: Annotated[bool, typer.Option(help="also heyoka's Taylor series, which bounds what is possible")] = True,
    coordinate_map: options.CoordinateMap = None,
    duration: options.Duration = None,
    out: Out = Path("reports/work-precision"),
) -> None:
    """Measure errors against stepping time and force evaluations, and the fastest runs at errors 1e-2 ... 1e-11."""
    ask = WorkPrecisionAsk(chosen(scene), chosen(engine), chosen(method), time_limit, repeats, bound, duration,
                           coordinate_map=coordinate_map)
    document = _conduct(WorkPrecision(), ask, out)
    terminal = console(180)
    bounded = any(front.bound_cost for each in document.scenes for front in each.frontier.get(each.compared, ()))
    for each in document.scenes:
        if each.failure:
            terminal.print(f"{each.name}: no truth: {each.failure}", markup=False)
            continue
        fronts, unit = each.frontier[each.compared], FRONTIERS[each.compared][1]
        error = "end error" if each.compared == "end position" else each.compared
        columns = [*figures(f"{error}, {unit}"), words("best of lieeuler"), *figures("ms"), words("best of the others"),
                   *figures("ms", "factor", *(("heyoka, ms", "to heyoka") if bounded else ()))]
        rows = []
        for front in fronts:
            own, other, *rest = shown((front.own_cost, front.other_cost, front.factor,
                                       *((front.bound_cost, front.to_bound) if bounded else ())), "-")
            rows.append((f"{front.level:.0e}", (front.own or "-").removeprefix("lieeuler "), own, front.other or "-",
                         other, *rest))
        print_table(terminal, columns, rows, f"{each.name}, {each.duration:g} s")
        some = [fronts[index] for index in SHOWN]
        labels = dict.fromkeys(label for front in reversed(some) for label in front.costs)
        print_table(terminal, [key(f"ms to an {error} of"), *figures(*(f"{front.level:.0e}" for front in some))],
                    [(label, *(figure(front.costs.get(label), "-") for front in some)) for label in labels])
        by_status = Counter(rung.status for rung in each.rungs)
        good, skipped, unsupported = (by_status[status] for status in ("success", "skipped", "unsupported"))
        say(f"{counted(good, 'run')}, {by_status.total() - good - skipped - unsupported} failed, {skipped} left out "
            f"for their time{f', {unsupported} unsupported' if unsupported else ''}; each time is the median of "
            f"{counted(repeats, 'round')}")
        print()
    say("factor: the time of the best of the others over that of lieeuler" + bounded * (
        "; to heyoka: the time of lieeuler over that of heyoka's Taylor series, which bounds what is possible"))
    _tell_page(out)


@app.command()
def drift(
    scene: Annotated[Names, options.scenes("single_pendulum double_pendulum")] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("rattle2 rattle4 DAE1L_LSE DAE1H_LSE RK4 RK44 RKMK4")] = None,
    step: Step = 2.0**-10,
    steps: Annotated[int, typer.Option(min=2, help="of each run")] = 1_000_000,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    coordinate_map: options.CoordinateMap = None,
    out: Out = Path("reports/drift"),
) -> None:
    """Measure the drift of energy, momentum, constraints and attitudes over long runs."""
    ask = DriftAsk(chosen(scene), chosen(engine), chosen(method), time_limit, step, steps,
                   coordinate_map=coordinate_map)
    document = _conduct(DriftStudy(), ask, out)
    columns = [key("scene"), key("run"), *figures("steps", "stepping, s"), words("energy"),
               *figures("energy band", "slope, 1/s", "slope T / band", "growth", "momentum band"), words("momentum"),
               *figures("constraint, m", "constraint, m/s", "constraint, m/s²", "orthogonality")]
    print_table(console(220), columns, [
        (run.scene, run.label, f"{run.steps:,}", figure(run.wall_time),
         run.energy_verdict or f"{run.status}: {run.reason}",
         *shown((run.energy_band, run.energy_slope, run.energy_trend, run.energy_growth), digits=".2g"),
         figure(run.momentum_band, digits=".1e"), run.momentum_verdict,
         *shown((run.constraint_position, run.constraint_velocity, run.constraint_acceleration, run.orthogonality),
                digits=".1e"))
        for run in document.runs])
    say("Energy errors are over the largest kinetic energy, momentum errors over the largest momentum. growth: the "
        "power of the number of steps with which the energy error grows, 0.5 for rounding alone")
    _tell_page(out)


@app.command()
def stability(
    scene: Annotated[Names, options.scenes('the scenes tagged "hard", both pendulums and the heavy top')] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("all with a fixed step")] = None,
    time_limit: Annotated[float, options.time_limit("longer ones are not tried")] = 2.0,
    jobs: Annotated[int, typer.Option(min=1, help="worker processes")] = 2,
    coordinate_map: options.CoordinateMap = None,
    step: Annotated[float | None, typer.Option(min=1e-9, help="s, the common step; default: one that suits each scene")
                    ] = None,
    duration: options.Duration = None,
    fresh: Annotated[bool, typer.Option(help="take no searches, which have times, from earlier studies")] = True,
    out: Out = Path("reports/stability"),
) -> None:
    """Find the largest usable step (end error below 10 %), the error at a common step, and how larger steps fail.

    A study that was killed continues when it is started again with the same arguments.
    """
    ask = StabilityAsk(chosen(scene), chosen(engine), chosen(method), time_limit, jobs, step, duration, fresh=fresh,
                       coordinate_map=coordinate_map)
    document = _conduct(Stability(), ask, out)
    terminal = console(200)
    columns = [key("scene"), key("run"), *figures("largest step, s", "steps", "error there", "ms", "common step, s"),
               words("error there"), words("how unusable runs ended")]
    print_table(terminal, columns, [
        (row.scene, f"{row.engine} {row.method}", figure(row.h_max, row.outcome), figure(row.steps, digits="d"),
         *shown((row.error, row.milliseconds, row.common_step)), figure(row.common_error, row.common_outcome),
         row.failures or row.reason)
        for row in document.rows if row.outcome != "unsupported"])
    best = [key("scene"), words("in-house"), *figures("step, s"), words("stock"), *figures("step, s", "ratio"),
            words("any other"), *figures("step, s", "ratio")]
    lines = [(line.scene, line.own, figure(line.own_h_max), line.stock, figure(line.stock_h_max),
              figure(line.ratio), line.any, figure(line.any_h_max), figure(line.ratio_any))
             for line in document.scenes if line.own]
    if lines:
        say("The largest steps of in-house methods, of engines that step by themselves (stock), and of all others, "
            "with the engines to which this package adds a stepper; ratio: the in-house step over theirs")
        print_table(terminal, best, lines)
    left = sum(row.outcome == "unsupported" for row in document.rows)
    say(f"{counted(len(document.rows), 'combination')}, {left} of them unsupported by their engine (reasons in "
        f"stability.csv), {document.meta.seconds:.0f} s with {counted(jobs, 'worker process', 'worker processes')}")
    _tell_page(out)


@app.command()
def chaos(
    scene: Annotated[Names, options.scenes("thrown_double thrown_triple")] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("rattle2 rattle4 DAE1L_LSE DAE1H_LSE RK4 RK44 RKMK4")] = None,
    duration: Annotated[float, typer.Option(min=1.0, help="s, of each run")] = 2000.0,
    step: Step = 2.0**-8,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    coordinate_map: options.CoordinateMap = None,
    out: Out = Path("reports/chaos"),
) -> None:
    """Compare distributions of energies and heights in chaotic scenes, beyond the time up to which trajectories agree.

    Exit code 0: no distribution differs; 1: one does.
    """
    ask = ChaosAsk(chosen(scene), chosen(engine), chosen(method), time_limit, duration, step,
                   coordinate_map=coordinate_map)
    document = _conduct(ChaosStudy(), ask, out)
    columns = [key("scene"), key("run"), *figures("horizon, s", "until, s", "energy error", "momentum error"),
               words("worst observable"), *figures("distance", "effective samples", "p"), words("verdict")]
    print_table(console(200), columns, [
        (run.scene, run.label, *shown((run.horizon, run.duration, run.energy_error, run.momentum_error)), run.worst,
         *shown((run.distance, run.effective, run.p)), run.verdict or f"{run.status}: {run.reason}")
        for run in document.runs])
    say(f"By chance alone one study in {1 / document.false_alarm:.0f} finds a difference: the smallest p of a run is "
        f"compared with {document.false_alarm:g} over the number of all comparisons")
    _tell_page(out)
    raise typer.Exit(int(any(run.verdict == "differs" for run in document.runs)))
