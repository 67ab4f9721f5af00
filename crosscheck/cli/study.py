"""`crosscheck study`: measurements over many runs, each for one question."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, figures, key, print_table, progress_bar, say, words
from crosscheck.cli.options import Engines, chosen, figure
from crosscheck.cli.options import figures as formatted
from crosscheck.errors import counted

if TYPE_CHECKING:
    from crosscheck.studies.study import Ask, Study, StudyDocument

Asked = TypeVar("Asked", bound="Ask")
Doc = TypeVar("Doc", bound="StudyDocument")

app = typer.Typer(name="study", no_args_is_help=True, add_completion=False, rich_markup_mode=None)

SHOWN = (1, 4, 7)
"""Indices of the error levels in the table of all methods, see `crosscheck.studies.work_precision.LEVELS`."""

Names = list[str] | None
Step = Annotated[float, typer.Option(min=1e-9, help="s; powers of 2, such as the default, add up without rounding")]
Out = Annotated[Path, typer.Option("--out", "-o", help="folder of the page, JSON and CSV")]


@app.callback()
def alone() -> None:
    """Work against precision, drift over long runs, largest usable steps; sweeps over parameters."""


def _conduct(study: Study[Asked, Any, Doc], ask: Asked, out: Path) -> Doc:
    """Run a study with a progress bar; returns its document."""
    from crosscheck.studies import study as studies

    with progress_bar("which runs there are") as progress:
        return studies.conduct(study, ask, out, progress)


def _print_page(out: Path) -> None:
    typer.echo(f"page: {out / 'index.html'}")


@app.command("work-precision")
def work_precision(
    scene: Annotated[Names, options.scenes("single_pendulum double_pendulum heavy_top")] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("all")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="interleaved rounds; their medians count")] = 5,
    time_limit: Annotated[float, options.time_limit("stepping only; longer runs are left out")] = 1.0,
    bound: Annotated[bool, typer.Option(help="also heyoka's Taylor series, which bounds what is possible")] = True,
    setting: options.SharedSettings = None,
    duration: options.Duration = None,
    out: Out = Path("reports/work-precision"),
) -> None:
    """Measure errors against stepping time and force evaluations, and the fastest runs at errors 1e-2 ... 1e-11."""
    from crosscheck.document import grouped
    from crosscheck.studies.work_precision import FRONTIERS, WorkPrecision, WorkPrecisionAsk

    ask = WorkPrecisionAsk(chosen(scene), chosen(engine), chosen(method), time_limit, repeats, bound, duration,
                           options=options.shared(setting))
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
            own, other, *rest = formatted((front.own_cost, front.other_cost, front.factor,
                                       *((front.bound_cost, front.to_bound) if bounded else ())), "-")
            rows.append((f"{front.level:.0e}", (front.own or "-").removeprefix("lieeuler "), own, front.other or "-",
                         other, *rest))
        print_table(terminal, columns, rows, f"{each.name}, {each.duration:g} s")
        some = [fronts[index] for index in SHOWN]
        labels = dict.fromkeys(label for front in reversed(some) for label in front.costs)
        print_table(terminal, [key(f"ms to an {error} of"), *figures(*(f"{front.level:.0e}" for front in some))],
                    [(label, *(figure(front.costs.get(label), "-") for front in some)) for label in labels])
        for label, mine in grouped(each.rungs, lambda rung: rung.label).items():
            if label not in labels and mine[-1].status != "unsupported":
                field = FRONTIERS[each.compared][0]
                least = min((value for rung in mine if (value := getattr(rung, field)) is not None), default=None)
                say(f"{label}: reaches none of these errors, " + (
                    "no run ended" if least is None else f"least {least:.1e} {unit}") + (
                    f"; {mine[-1].reason}" if mine[-1].reason else ""))
        by_status = Counter(rung.status for rung in each.rungs)
        good, skipped, unsupported = (by_status[status] for status in ("success", "skipped", "unsupported"))
        say(f"{counted(good, 'run')}, {by_status.total() - good - skipped - unsupported} failed, {skipped} left out "
            f"for their time{f', {unsupported} unsupported' if unsupported else ''}; each time is the median of "
            f"{counted(repeats, 'round')}")
        print()
    say("factor: the time of the best of the others over that of lieeuler" + bounded * (
        "; to heyoka: the time of lieeuler over that of heyoka's Taylor series, which bounds what is possible")
        + "; lieeuler reduces planar scenes and spins about an axis of symmetry, see --set reduce=off, spin_free=false")
    _print_page(out)


@app.command()
def drift(
    scene: Annotated[Names, options.scenes("single_pendulum double_pendulum")] = None,
    engine: Engines = None,
    method: Annotated[Names, options.methods("rattle2 rattle4 DAE1L_LSE DAE1H_LSE RK4 RK44 RKMK4")] = None,
    step: Step = 2.0**-10,
    steps: Annotated[int, typer.Option(min=2, help="of each run")] = 1_000_000,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    setting: options.SharedSettings = None,
    out: Out = Path("reports/drift"),
) -> None:
    """Measure the drift of energy, momentum, constraints and attitudes over long runs.

    Exit code 0: something was measured; 1: nothing, and a run failed; 3: nothing.
    """
    from crosscheck.studies.drift import DriftAsk, DriftStudy

    ask = DriftAsk(chosen(scene), chosen(engine), chosen(method), time_limit, step, steps,
                   options=options.shared(setting))
    document = _conduct(DriftStudy(), ask, out)
    columns = [key("scene"), key("run"), *figures("steps", "stepping, s"), words("energy"),
               *figures("energy band", "slope, 1/s", "slope T / band", "growth", "momentum band"), words("momentum"),
               *figures("constraint, m", "constraint, m/s", "constraint, m/s²", "orthogonality")]
    print_table(console(220), columns, [
        (run.scene, run.label, f"{run.steps:,}", figure(run.wall_time),
         run.energy_verdict or f"{run.status}: {run.reason}",
         *formatted((run.energy_band, run.energy_slope, run.energy_trend, run.energy_growth), digits=".2g"),
         figure(run.momentum_band, digits=".1e"), run.momentum_verdict,
         *formatted((run.constraint_position, run.constraint_velocity, run.constraint_acceleration, run.orthogonality),
                digits=".1e"))
        for run in document.runs])
    say("Energy errors are over the largest kinetic energy, momentum errors over the largest momentum. growth: the "
        "power of the number of steps with which the energy error grows, 0.5 for rounding alone")
    _print_page(out)
    if not any(run.status == "success" for run in document.runs):
        raise typer.Exit(1 if any(run.status == "failed" for run in document.runs) else 3)


@app.command()
def stability(
    scene: Annotated[Names, options.scenes('the scenes tagged "hard", both pendulums and the heavy top')] = None,
    engine: Engines = None,
    jobs: Annotated[int, typer.Option(min=1, help="worker processes")] = 2,
    fresh: Annotated[bool, typer.Option(help="take no runs, which have times, of earlier studies")] = True,
    out: Out = Path("reports/stability"),
) -> None:
    """Tell the largest usable step of every method, and how larger ones fail, from runs at a series of steps.

    A study that was killed continues when it is started again with the same arguments.
    """
    from crosscheck.studies.stability import Stability, StabilityAsk

    document = _conduct(Stability(), StabilityAsk(chosen(scene), chosen(engine), jobs=jobs, fresh=fresh), out)
    columns = [key("scene"), key("run"), *figures("largest step, s", "rtol", "error there", "ms", "breaks at"),
               words("how")]
    print_table(console(200), columns, [
        (line.scene, line.label, *formatted((line.step, line.rtol, line.error, line.milliseconds, line.breaks_at)),
         line.reason) for line in document.lines])
    _print_page(out)


@app.command()
def sweep(
    file: Annotated[Path, typer.Argument(help="TOML file: scenes, engines, steps and/or rtols, parameters, perturb")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="folder of results and page; finished cells are kept")
                   ] = None,
    workers: Annotated[int, typer.Option(min=1, help="processes of this machine")] = 2,
    scheduler: options.Scheduler = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only print the number of cells and the time")] = False,
    fresh: options.Fresh = "CI" in os.environ,
    cell: Annotated[str | None, typer.Option(help="run only this cell again, and print its row")] = None,
) -> None:
    """Run a sweep. Finished cells are not computed again, so the same command continues an interrupted sweep."""
    import msgspec

    from crosscheck.sweeps import job as sweeps

    target = out or Path("reports") / f"sweep-{file.stem}"
    if dry_run:
        count, missing, seconds = sweeps.estimate(file, target, workers)
        spoken = (f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min" if seconds < 7200 else
                  f"{seconds / 3600:.1f} h")
        say(f"{counted(count, 'cell')}, of which {count - missing} finished and {missing} to be computed, about "
            f"{spoken} with {counted(workers, 'worker')}")
        return
    if cell is not None:
        for name, value in msgspec.structs.asdict(sweeps.one(file, cell)).items():
            typer.echo(f"{name}: {value}")
        return
    with progress_bar(f"reading {file}") as progress:
        frame = sweeps.sweep(file, workers, scheduler, target, progress, fresh)
    report = frame.attrs["report"]
    counts = frame.groupby(["scene", "engine", "method"], dropna=False)
    print_table(console(160), [key("scene"), key("engine"), key("method"), *figures(
        "cells", "failed", "median position error, m", "largest, m")], [
        (scene, engine, method, str(len(rows)), str(int((rows["status"] != "success").sum())),
         f"{rows['position_error'].median():.3g}", f"{rows['position_error'].max():.3g}")
        for (scene, engine, method), rows in counts])
    say(f"{counted(len(frame), 'cell')}, {report['computed']} computed in {report['seconds']:.1f} s with "
        f"{counted(report['workers'], 'worker')}: truth {report['truth_seconds']:.1f} s, runs "
        f"{report['run_seconds']:.1f} s, overhead {1e3 * report['overhead']:.1f} ms a cell")
    for text in report["trouble"]:
        say(f"without truth: {text}")
    page = target / "index.html"
    typer.echo(f"page: {page}" if page.exists() else f"results: {target / 'parts'} (no page: pip install "
               "'lieeuler-crosscheck[report]')")
