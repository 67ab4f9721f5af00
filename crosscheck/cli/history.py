"""`crosscheck history`: the runs in the store, changes between two of them, and the trend of a figure."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.console import console, figures, key, print_table, say, words
from crosscheck.cli.options import FORM
from crosscheck.errors import ArgumentError, counted, unknown

if TYPE_CHECKING:
    from sqlalchemy import Engine

app = typer.Typer(name="history", add_completion=False, rich_markup_mode=None)

OUTCOME = "outcome"
"""A column of `show` that is not a number; `trend` prints where it changed."""

Store = Annotated[str | None, typer.Option("--store", help="an SQLite file or postgresql://...; default: "
                                           "CROSSCHECK_STORE, else reports/history.sqlite")]
Run = Annotated[str, typer.Argument(help="name of a run, its beginning, or latest")]


@app.callback(invoke_without_command=True)
def alone(context: typer.Context, store: Store = None) -> None:
    """The runs in the store, their changes and trends; alone: the last runs."""
    if context.invoked_subcommand is None:
        list_(store)
    elif store is not None:
        raise ArgumentError(f"--store stands after {context.invoked_subcommand}")


@app.command("list")
def list_(store: Store = None, limit: Annotated[int, typer.Option(help="how many of the last runs")] = 20) -> None:
    """The last runs, the newest first."""
    from crosscheck.history import runs as stored

    rows = []
    with _opened(store) as opened:
        for run in stored.recent(opened, limit):
            engines = ", ".join(f"{name} {version}" for name, version in sorted(run.versions["engine"].items()))
            machine = f"{run.environment.processor}, {run.environment.cores} cores"
            rows.append((run.name, run.profile, str(run.exit_code), "yes" if run.good else "",
                         run.environment.commit or "", machine, engines))
    if not rows:
        say(stored.EMPTY)
        return
    columns = [key("run"), *figures("profile", "exit", "compared with", "commit"), words("machine"), words("engines")]
    print_table(console(200), columns, rows)


@app.command()
def show(run: Run = "latest", store: Store = None,
         scene: Annotated[str | None, typer.Option(help="only this scene")] = None,
         metric: Annotated[list[str] | None, typer.Option(help="may be repeated")] = None) -> None:
    """The figures of one run."""
    from crosscheck.history import runs as stored

    wanted = metric or ["position error", "order", "energy error", "us per step", "speed ratio"]
    with _opened(store) as opened:
        past = stored.load(opened, stored.find(opened, run))
    known = sorted({name for result in past.results.values() for name in result.figures})
    for name in wanted:
        if metric and name not in known:
            raise ArgumentError(_no("metric", name, known))
    rows = []
    for result in past.results.values():
        if scene in (None, result.key[0]):
            row = [result.key[0], result.label, result.outcome]
            for name in wanted:
                figure = result.figures.get(name)
                unit = f" {figure.unit}" if figure and figure.unit not in ("1", *name.split()) else ""
                row.append(f"{figure.value:.4g}{unit}" if figure else "")
            rows.append(tuple(row))
    say(f"{past.name}: {past.command}, exit code {past.exit_code}, commit {past.environment.commit or 'unknown'}")
    print_table(console(200), [key("scene"), key("run"), *figures("outcome", *wanted)], rows)


@app.command()
def compare(before: Run, after: Run = "latest", store: Store = None) -> None:
    """Print what changed from one run to another; exit code 1 if something became worse."""
    from crosscheck.history import changes
    from crosscheck.history import runs as stored

    with _opened(store) as opened:
        old, new = (stored.load(opened, stored.find(opened, name)) for name in (before, after))
    changed = changes.compare(old, new)
    typer.echo(f"{old.name} -> {new.name}")
    for change in changed:
        mark = "✗" if change.bad else "·"
        place = f"{change.scene}, " if change.scene else ""
        say(f"{mark} {change.kind}: {place}{change.who or 'all engines'}: {change.text}")
    if not changed:
        typer.echo("nothing beyond rounding and noise")
    raise typer.Exit(int(any(change.bad for change in changed)))


@app.command()
def trend(
    metric: Annotated[str, typer.Argument(help="a column of `crosscheck history show`, such as \"speed ratio\"")],
    scene: Annotated[str, typer.Option(help="name of the scene")],
    engine: Annotated[str, typer.Option(help="name of the engine")],
    method: Annotated[str, typer.Option(help="name of the method")],
    form: Annotated[str, typer.Option(help=FORM + "the engine's choice")] = "",
    page: Annotated[Path | None, typer.Option(help="also write a page with the curve")] = None,
    store: Store = None,
) -> None:
    """Print one figure over all runs, with its change points marked ◆."""
    from crosscheck.history import changes
    from crosscheck.history import runs as stored
    from crosscheck.history.overview import write_trend

    cell = (scene, engine, method, form)
    if metric == OUTCOME:
        with _opened(store) as opened:
            outcomes = stored.outcomes(opened, cell)
        if not outcomes:
            raise ArgumentError(_no("metric", OUTCOME, []))
        typer.echo(f"{OUTCOME}, {counted(len(outcomes), 'run')}")
        for outcome, runs in itertools.groupby(outcomes, key=lambda each: each[1]):
            names = [name for name, _ in runs]
            typer.echo(f"{outcome}: {counted(len(names), 'run')} from {names[0]} on")
        return
    with _opened(store) as opened:
        series = stored.series(opened, metric, cell)
        if not series:
            raise ArgumentError(_no("metric", metric, stored.figure_names(opened, cell)))
    series_of = [figure for _, figure in series]
    changed = changes.change_points(series_of)
    unit = "" if series_of[0].unit == "1" else f" {series_of[0].unit}"
    label = f"{engine} {method}" + (f" ({form})" if form else "")
    typer.echo(f"{metric} of {label} on {scene}, {counted(len(series), 'run')}")
    typer.echo(changes.sparkline([figure.value for figure in series_of])
               + f"  {series_of[0].value:.4g} -> {series_of[-1].value:.4g}{unit}")
    if changed:
        typer.echo("".join("◆" if index in changed else " " for index in range(len(series))).rstrip())
    for index in changed:
        typer.echo(f"◆ {series[index][0].name}: {series_of[index - 1].value:.4g} -> {series_of[index].value:.4g}{unit}"
                   f", commit {series[index][0].environment.commit or 'unknown'}")
    if page is not None:
        write_trend(page, series, scene, engine, label)
        typer.echo(f"page: {page}")


@app.command()
def page(out: Annotated[Path, typer.Option(help="folder of the page; beside reports it shares their menus")] = Path(
             "reports/history"), store: Store = None) -> None:
    """Write the page of the history: sparklines of every scene and engine, and of the series of every run."""
    from crosscheck.history.overview import write_history

    with _opened(store) as opened:
        typer.echo(f"page: {write_history(out, opened)}")


@app.command()
def add(folder: Annotated[Path, typer.Argument(help="a report, or its results.json")], store: Store = None) -> None:
    """Add a run of `crosscheck verify` to the store; it counts as good if all its verdicts pass."""
    from crosscheck.history import runs as stored
    from crosscheck.report.schema import read_document

    path = folder if folder.suffix == ".json" else folder / "results.json"
    document = read_document(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:4]
    name = f"{document.meta.time.removesuffix(' UTC').replace(' ', 'T').replace(':', '-')}-{digest}"
    with _opened(store) as opened:
        new = stored.save(opened, stored.run_from_document(name, document, good=document.exit_code == 0))
    typer.echo(f"{'added' if new else 'already there'}: {name}")


@app.command()
def accept(run: Run = "latest", store: Store = None) -> None:
    """Compare later runs with this one, even if its verdicts changed, because the changes are intended."""
    from crosscheck.history import runs as stored

    with _opened(store) as opened:
        name = stored.find(opened, run)
        stored.set_good(opened, name)
    typer.echo(f"accepted: {name}")


def _no(what: str, name: str, known: list[str]) -> str:
    return unknown(what, name, known) if known else (
        "no run in the store has this scene, engine, method and form; `crosscheck history show` lists what it has")


@contextlib.contextmanager
def _opened(where: str | None) -> Iterator[Engine]:
    from crosscheck.history import runs as stored

    engine = stored.open_store(where)
    try:
        yield engine
    finally:
        engine.dispose()
