"""Many runs: `crosscheck verify` and `nightly`; what is made of them again: `report`."""

from __future__ import annotations

import dataclasses
import math
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli import options
from crosscheck.cli.console import annotate, complain, console, figures, key, print_table, progress_bar, say
from crosscheck.cli.options import EngineNames, SceneNames
from crosscheck.errors import ArgumentError, counted, install

if TYPE_CHECKING:
    from crosscheck.document import Document, Record
    from crosscheck.recordings import published

NAMED = 3
"""Most runs of one documented order whose observed orders are printed one by one."""

STYLES = {"fail": "bold red", "error": "bold red", "known": "yellow", "unsupported": "dim"}


@options.reads_models
def verify(
    scenes: options.Scenes = None,
    scene: SceneNames = None,
    engine: EngineNames = None,
    method: Annotated[list[str] | None, typer.Option(help="a name; may be repeated; default: all")] = None,
    profile: Annotated[str, typer.Option(help="default: four scenes; smoke: their first second, no timing; "
                                         "full: every scene, within a budget of steps")] = "default",
    setting: options.SharedSettings = None,
    step: options.Step = None,
    duration: options.Duration = None,
    jobs: options.Jobs = 2,
    scheduler: options.Scheduler = None,
    time_limit: options.TimeLimit = 1800.0,
    memory_limit: options.MemoryLimit = 4.0,
    tolerance_file: Annotated[Path | None, typer.Option(
        "--tolerances", help="TOML file with your own tolerances")] = None,
    tol: Annotated[list[str] | None, typer.Option(
        help="largest error against truth, such as position=1e-3 (SI); may be repeated")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="folder of the report")] = Path("reports/latest"),
    as_json: Annotated[bool, typer.Option("--json", help="print the results as JSON instead of the table")] = False,
    form: options.Format = "text",
    budget: Annotated[float | None, typer.Option(help="s, after which what has ended is printed and on the page, "
                                                 "as provisional; cheap runs come first, and the rest goes on")] = None,
    need: options.Need = 1.0,
    fresh: options.Fresh = "CI" in os.environ,
    reading: options.Reading = options.AS_IT_IS,
    tag: Annotated[list[str] | None, typer.Option(help="scenes with this tag; may be repeated; published: their "
                                                  "figures in the literature, too")] = None,
) -> None:
    """Run every method and engine over the scenes, judge the runs, and write the report. Where there is none yet, its
    page comes after seconds and fills as runs end.

    A run passes if it converges to truth with its documented order as the step vanishes; its error at this step is a
    figure beside that, and fails only by --tol. Results of earlier runs of the same code and versions are taken, also
    after a kill; times are measured anew.

    Exit code 0: every run passes or shows only known defects; 1: one fails or did not run, or a scene lacks the truth
    that it should have; 3: nothing fails, and a run is unresolved: over a part of its time, more
    than --need allows, the uncertainty is too large.
    """
    from crosscheck.document import Asked
    from crosscheck.judge import overrides
    from crosscheck.report import schema
    from crosscheck.report.headline import ending, sentence
    from crosscheck.scene.file import as_scene, tagged
    from crosscheck.scene.models import is_model
    from crosscheck.verification.job import check_methods, limits_of, select_engines
    from crosscheck.verification.verified import Verification
    from crosscheck.verification.verified import verify as verify_scenes

    if tag and not tagged(*tag):
        raise ArgumentError(f"--tag: no built-in scene is tagged {', '.join(tag)}; crosscheck list names the tags")
    check_methods(method, select_engines(engine))  # what is mistyped is refused before a model is read
    names = [*(scenes or ()), *(scene or ()), *tagged(*tag or ())]
    wanted = bool(tol or tolerance_file)
    if wanted and None not in (sensors := [options.sensors(name) for name in names]):
        overrides.read(tolerance_file, tol or (), [each for own in sensors for each in own or ()])
    given = [options.loaded(name, reading) if is_model(name) else name for name in names]
    own = overrides.read(tolerance_file, tol or (), [
        sensor.name for each in given if wanted for sensor in as_scene(each).sensors])
    spoken = [(name, shlex.join([name, *reading.words]) if is_model(name) else name) for name in names]

    def provisional(part: Verification) -> None:
        meta = part.document.meta
        print(f"provisional: {part}; {counted(meta.left, 'task')} left after {meta.seconds:.0f} s; {part.page}",
              file=sys.stderr if as_json else sys.stdout, flush=True)

    with progress_bar("which runs there are") as progress:
        answer = verify_scenes(
            given or None, engine, method, step, need, budget, duration=duration, profile=profile,
            asked=Asked(options=options.shared(setting)), jobs=jobs, scheduler=scheduler,
            limits=limits_of(time_limit, memory_limit), tolerances=own, fresh=fresh, out=out, spoken=spoken,
            command=shlex.join(["crosscheck", *sys.argv[1:]]), progress=progress, note=complain,
            on_budget=provisional)
    results, page = answer.document, answer.page or out
    if page.suffix == ".json":
        complain(f"no pages: {install('jinja2')}, then crosscheck report {out}")
    literature: Sequence[published.Figure] = ()
    if tag:
        from crosscheck.recordings import published  # with the room of recordings: a second that few need

        literature = published.figures(tagged(*tag), tuple(results.meta.engines))
    if as_json:
        more = {"published": [dataclasses.asdict(figure) for figure in literature]} if tag else {}
        options.print_json(schema.plain(results) | {"report": str(page)} | more)
    else:
        print_verdicts(results, page)
        _print_published(literature)
    for record in results.records if form == "github" else ():
        if record.outcome in ("fail", "error", "unresolved"):
            annotate(record.outcome, f"{record.code} {record.scene} {record.label}",
                     "; ".join(filter(None, (sentence(record), ending(record)))))
    raise typer.Exit(results.exit_code)


def print_verdicts(document: Document, page: Path) -> None:
    """Print the outcome, passes by engine and scene, every other run, what is wrong and what to trust, the page."""
    import msgspec

    from crosscheck.document import grouped
    from crosscheck.report.headline import OUTCOMES, ROW, advice, assumptions, ending, headline, row, sentence
    from crosscheck.report.overview import worst_first

    titles = {scene.name: scene.title for scene in document.scenes}
    if len(set(titles.values())) == len(titles):  # a path is long, and of a model file one in the cache folder
        document = msgspec.structs.replace(
            document, scenes=[msgspec.structs.replace(scene, name=scene.title) for scene in document.scenes],
            records=[msgspec.structs.replace(record, scene=titles[record.scene]) for record in document.records])
    for answer in document.answers:
        say(answer)
    say(f"{document.outcome}: {headline(document)} ({document.meta.seconds:.0f} s)")
    say("engines: " + ", ".join(f"{name} {version}" for name, version in document.meta.engines.items()))
    for each in assumptions(document.records):
        say(each)
    if document.meta.reused:
        say(f"{counted(document.meta.reused, 'result')} from earlier runs, since "
            f"{(document.meta.reused_since or '')[:10]}; --fresh computes them anew")
    terminal = console(160)
    for outcome in ("pass", "unresolved"):
        right = (each for each in document.records if each.outcome == outcome and (outcome == "pass" or each.within))
        for (name, engine), records in grouped(right, lambda record: (record.scene, record.engine)).items():
            _print_right(name, engine, records)
    findings = [record for record in document.records if record.outcome in ("known", "fail", "error")]
    if findings:
        print_table(terminal, [*map(key, ROW[:2]), *figures(*ROW[2:])], [row(record) for record in findings],
                    styles=[STYLES.get(record.outcome, "") for record in findings])
    for group in worst_first(document.records):
        symbol, word, _ = OUTCOMES[group.outcome]
        loud = word.upper() if group.outcome in ("fail", "error") else word
        say(f"{symbol} {loud}: {group.engine + ': ' if group.engine else ''}{group.why}")
        for record, _ in group.runs:
            say(f"{record.scene}, {record.label}: {sentence(record)}", 4)
            if last := ending(record):
                (say if record.outcome == "unresolved" else print)(last)  # a command is one line, to be copied
    left_out = (record for record in document.records
                if record.outcome == "unsupported" or (record.outcome == "unresolved" and not record.within))
    for (outcome, name, message), records in grouped(
            left_out, lambda record: (record.outcome, record.scene, record.message)).items():
        say(f"{' '.join(OUTCOMES[outcome][:2])} {name}, {message}: {', '.join(record.label for record in records)}"
            + (f"; {records[0].code}; {ending(records[0])}" if outcome == "unresolved" else ""))
    for scene in document.scenes:
        say(f"{scene.name}: {advice(scene)}")
        for trusted in scene.engines if len(scene.engines) > 1 else ():
            say(trusted.text, 4)
    print(f"report: {page}")


def _print_published(literature: Sequence[published.Figure]) -> None:
    """Print published figures beside truth and the engines; those that differ from truth are marked."""
    if not literature:
        return
    from crosscheck.report.headline import brief

    engines = list(dict.fromkeys(name for figure in literature for name in figure.engines))
    columns = (key("scene"), key("figure"), *figures("printed to", "literature - truth", "truth known to",
                                                     *(f"{name} - truth" for name in engines)))
    print_table(console(160), columns, [
        (figure.scene, figure.what, f"{figure.error:.0e}", f"{figure.truth:.1e}{' !' if figure.differs else ''}",
         f"{figure.known:.0e}", *(brief(figure.engines.get(name)) for name in engines)) for figure in literature],
        title="Literature, truth and engines; !: beyond the printed digits and the error of truth")
    for source in dict.fromkeys(figure.source for figure in literature if figure.differs):
        say(f"! differs from truth: {source}")


def _print_right(scene: str, engine: str, right: Sequence[Record]) -> None:
    """Print one line for all runs of an engine on a scene that have one outcome and nothing wrong."""
    from crosscheck.document import grouped
    from crosscheck.report.headline import OUTCOMES, ending, share_words

    best, first = min(right, key=lambda record: record.error), right[0]
    part = "" if first.outcome == "pass" else (
        f", {first.outcome}: {share_words(right)}, since {first.not_judged}")
    line = (f"{OUTCOMES[first.outcome][0]} {scene}, {engine}: {len(right)} run"
            f"{' behaves' if len(right) == 1 else 's behave'} as documented{part}")
    if math.isfinite(best.error):
        who = best.label.removeprefix(f"{engine} ")
        line += f", least error {best.error:.1e} of its size, by {who} at {best.size}"
    shown = grouped(((record, record.order.observed) for record in right if record.order is not None),
                    lambda pair: pair[0].documented_order)
    orders = list[str]()
    for documented, pairs in shown.items():
        seen = [observed for _, observed in pairs]
        many = [f"{min(seen):.2f} to {max(seen):.2f} of {len(seen)} runs"] if len(seen) > NAMED else [
            f"{record.label.removeprefix(f'{engine} ')} {observed:.2f}" for record, observed in pairs]
        orders += [f"{each}, documented {documented}" for each in many]
    if orders:
        line += f"; observed order: {'; '.join(orders)}"
    say("; ".join(filter(None, (line, ending(first)))))


def nightly(
    scene: options.SceneNames = None,
    engine: options.Engines = None,
    profile: Annotated[str, typer.Option(help="as in `crosscheck verify`")] = "full",
    setting: options.SharedSettings = None,
    step: options.Step = None,
    duration: options.Duration = None,
    jobs: options.Jobs = 2,
    scheduler: options.Scheduler = None,
    time_limit: options.TimeLimit = 1800.0,
    memory_limit: options.MemoryLimit = 4.0,
    out: Annotated[Path, typer.Option("--out", "-o", help="folder with a subfolder per run, and the link latest")
                   ] = Path("reports/nightly"),
    store: Annotated[str | None, typer.Option(help="history: an SQLite file or postgresql://...; default: "
                                              "CROSSCHECK_STORE, else history.sqlite beside the folder --out"
                                              )] = None,
    fresh: Annotated[bool, typer.Option(help="compute everything anew")] = True,
    keep: Annotated[int, typer.Option(help="number of reports to keep; the history keeps all runs")] = 14,
) -> None:
    """Run everything, compare with the last good run, store the result and write the report.

    A run that was killed continues when the command is repeated.

    Exit code 0: nothing fails or became worse; 1: a run fails or did not run, or something became worse; 3: a run could
    not be judged over all of its time.
    """
    from crosscheck.document import Asked
    from crosscheck.history import nightly as nights
    from crosscheck.verification.job import limits_of

    asked = Asked(options=options.shared(setting), step=step, duration=duration)
    wanted = nights.Wanted(profile, scene, engine, jobs, limits_of(time_limit, memory_limit), asked, scheduler, fresh)
    with progress_bar("which runs there are") as progress:
        night = nights.nightly(out, wanted, store, keep, progress)
    for line in night.summary.splitlines():
        say(line, hang=2)
    raise typer.Exit(night.exit_code)


def report(
    run: Annotated[Path, typer.Argument(help="folder of a report, or its results.json")] = Path("reports/latest"),
    format_: Annotated[str, typer.Option("--format", callback=options.among("--format", "html", "svg", "paper"), help=(
        "html: write the pages again; svg: the main plots in figures/; paper: "
        "figures, tables, LaTeX and BibTeX in paper/"))] = "html",
) -> None:
    """Render a finished run again from its results.json, without running anything."""
    from crosscheck import report as site
    from crosscheck.report.figures import write_figures
    from crosscheck.report.paper import write_paper

    folder = run.parent if run.name == "results.json" else run
    if not folder.is_dir():
        raise ArgumentError(f"{run}: no such folder; name one that `crosscheck verify` wrote, such as reports/latest")
    if format_ == "svg":
        written = write_figures(site.load_report(folder), folder / site.FIGURES)
        typer.echo(f"{len(written)} figures: {folder / site.FIGURES}")
    elif format_ == "paper":
        typer.echo(f"document: {write_paper(site.load_report(folder), folder / site.PAPER)}")
    else:
        typer.echo(f"report: {site.rewrite_pages(folder)}")
