"""The command `crosscheck`: its subcommands and the handling of their errors."""

from __future__ import annotations

import importlib.metadata
import io
import os
import sys
from typing import Annotated

import typer

from crosscheck.cli.console import INTERRUPTED, complain, interrupted
from crosscheck.cli.engines import inspect, list_, support
from crosscheck.cli.history import app as history
from crosscheck.cli.models import bisect, derivatives, diff, export, import_, modes, reproduce
from crosscheck.cli.runs import advise, explain, judge, law, run, truth
from crosscheck.cli.study import app as study
from crosscheck.cli.verify import nightly, paper, report, sweep, verify
from crosscheck.errors import CrosscheckError, missing

app = typer.Typer(name="crosscheck", add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
                  help="One multibody scene, many engines, every result measured against independent truth. Begin with "
                       "`crosscheck list` and `crosscheck verify --scene double_pendulum --profile smoke`.")


@app.callback()
def root(version: Annotated[bool, typer.Option("--version", help="versions of crosscheck and of the engines",
                                               is_eager=True, callback=lambda asked: _print_versions(asked))] = False
         ) -> None:
    """Options before any subcommand."""


def _print_versions(asked: bool) -> None:
    if not asked:
        return
    from crosscheck import adapters
    from crosscheck.running.provenance import engine_version

    typer.echo(f"crosscheck {importlib.metadata.version('lieeuler-crosscheck')}")
    for name in adapters.names():
        typer.echo(f"{name} {engine_version(name)}")
    raise typer.Exit


for command in (verify, judge, advise, run, truth, explain, law, inspect, derivatives, modes, diff, reproduce, bisect,
                support, report, paper, nightly, sweep):
    app.command()(command)
app.command("list")(list_)
app.command("import")(import_)
app.command()(export)
app.add_typer(history)
app.add_typer(study)


def main() -> None:
    """Entry point: every error prints one clear line and gives exit code 2; exit code 1 means a failed verdict."""
    for stream in (sys.stdout, sys.stderr):  # messages of engines may hold characters that cannot be encoded
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        os.getcwd()
    except FileNotFoundError:
        complain("the current folder has been removed; change to another one")
        raise SystemExit(2) from None
    try:
        app()
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            raise SystemExit(2) from None  # the reader of the output, such as `head`, has closed it
        if end.code == INTERRUPTED:
            complain(interrupted())
        raise
    except KeyboardInterrupt:
        complain(interrupted())
        raise SystemExit(INTERRUPTED) from None
    except Exception as error:
        if os.environ.get("CROSSCHECK_TRACEBACK"):
            raise
        complain(str(error) if isinstance(error, CrosscheckError) else
                 missing(error) if isinstance(error, ImportError) else
                 f"{type(error).__name__}: {error} (CROSSCHECK_TRACEBACK=1 in the environment shows where)")
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
