"""`crosscheck study`: measurements over many runs that answer one question each."""

from __future__ import annotations

import typer

from crosscheck.cli.chaos import chaos
from crosscheck.cli.drift import drift
from crosscheck.cli.stability import stability
from crosscheck.cli.work_precision import work_precision

app = typer.Typer(name="study", no_args_is_help=True,
                  help="Work against precision, drift over long runs, largest usable steps, chaos.")
app.command("work-precision")(work_precision)
app.command("drift")(drift)
app.command("stability")(stability)
app.command("chaos")(chaos)
