"""The command `crosscheck`: its subcommands and the handling of their errors."""

from __future__ import annotations

import ast
import functools
import importlib.metadata
import io
import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from crosscheck.cli.console import INTERRUPTED, at_work, complain, interrupted, warnings_in_one_line
from crosscheck.errors import CrosscheckError, missing, named

COMMANDS = {
    "verify": "verify", "judge": "runs", "run": "runs", "advise": "runs", "inspect": "engines", "explain": "runs",
    "study": "study", "linearise": "models", "truth": "runs", "convert": "models", "nightly": "verify",
    "history": "history", "list": "engines", "bisect": "models", "report": "verify"}
"""The file of each command."""

FIRST = 5
"""The number of commands, the first ones, that answer most questions."""

FUNCTIONS = {"list": "list_", "history": "alone", "study": "alone"}
"""The function of a command with another name. Those with commands of their own have `alone`, and an `app`."""


OWN = ("crosscheck", "lieeuler")
"""Packages whose modules are always there."""

REPORT = ("please report it where you have crosscheck from, with the command, its files and what "
          "CROSSCHECK_TRACEBACK=1 in the environment shows")

RENAMED = {"diff": ("inspect",), "support": ("list", "--support"), "paper": ("report", "--format", "paper"),
           "law": ("advise",), "sweep": ("study", "sweep"), "derivatives": ("linearise",),
           "modes": ("linearise", "--modes"), "import": ("convert",), "export": ("convert",),
           "reproduce": ("run", "--script", "--engine", "mujoco", "--method", "RK4", "--step", "1e-3")}
"""Former commands, and the words that replace them."""

SETTINGS = {"--map": "coordinate_map", "--softness": "softness", "--node": "node", "--alpha": "alpha", "--beta": "beta",
            "--spectral-radius": "spectral_radius", "--correction": "correction", "--reduce": "reduce",
            "--conserve": "conserve=true", "--no-conserve": "conserve=false"}
"""Former options, and what --set takes in their place."""


@functools.cache
def loaded(name: str) -> Any:
    """A command, whose file is imported, and with it what it needs."""
    module = importlib.import_module(f"crosscheck.cli.{COMMANDS[name]}")
    if FUNCTIONS.get(name) == "alone":
        return get_command(module.app)
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name)(getattr(module, FUNCTIONS.get(name, name)))
    return get_command(single)


class _Commands(Mapping[str, Any]):
    """All commands by name. They are imported one by one, when they are asked for."""

    __getitem__ = staticmethod(loaded)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class Commands(TyperGroup):
    """The command `crosscheck`, which lists its commands without importing them."""

    commands: Any

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = _Commands()

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the words begin with; a former one is named by its new words, and run."""
        if args[0] in RENAMED:
            complain(f"crosscheck {args[0]} is now: crosscheck {shlex.join(RENAMED[args[0]])}")
        words = list(_renewed([*RENAMED.get(args[0], args[:1]), *args[1:]]))
        if sys.argv[1:] == args:
            sys.argv[1:] = words  # in the commands that are printed
        return super().resolve_command(ctx, words)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write what each function says of itself in its file, without importing it."""
        docstrings: dict[tuple[str, str], str] = {}
        for file in set(COMMANDS.values()):
            tree = ast.parse(Path(__file__).with_name(f"{file}.py").read_text(encoding="utf-8"))
            docstrings |= {(file, node.name): ast.get_docstring(node) or "" for node in tree.body
                     if isinstance(node, ast.FunctionDef)}
        rows = [(name, " ".join(re.split(r"\.(?:\s|$)", docstrings[file, FUNCTIONS.get(name, name)])[0].split()))
                for name, file in COMMANDS.items()]
        for title, part in (("Commands that answer a question", rows[:FIRST]), ("Others", rows[FIRST:])):
            with formatter.section(title):
                formatter.write_dl(part)


def _renewed(args: list[str]) -> Iterator[str]:
    """The words with --set in place of former options, each of which is named once."""
    words = iter(args)
    for word in words:
        option, equals, value = word.partition("=")
        setting = SETTINGS.get(option)
        if option == "--derivatives" and args[0] == "inspect":
            raise CrosscheckError("inspect --derivatives is now: crosscheck linearise SCENE --source ENGINE")
        if option == "--against" and args[0] == "inspect":
            complain("inspect A --against B is now: crosscheck inspect A B")
            yield from [value] if equals else []
            continue
        if setting is None:
            yield word
            continue
        if "=" not in setting:
            setting = f"{setting}={value if equals else next(words, '')}"
        complain(f"{option} is now: --set {setting}")
        yield from ("--set", setting)


app = typer.Typer(name="crosscheck", cls=Commands, add_completion=False, rich_markup_mode=None, no_args_is_help=True,
                  pretty_exceptions_enable=False,
                  help="Does an engine, a method or a log solve the equations of motion, and to which error? Each is "
                       "compared with truth, a reference solution by two independent formulations. A scene is a name "
                       "of `crosscheck list`, a .toml, an MJCF or a URDF. Begin with `crosscheck verify --scene "
                       "double_pendulum --profile smoke`.")


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


def main() -> None:
    """Entry point: every error prints one clear line. Exit codes are those of `crosscheck.document.outcomes`.

    What the user can mend gives 2, a mistake of ours 70.
    """
    for stream in (sys.stdout, sys.stderr):  # messages of engines may hold characters that cannot be encoded
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        os.getcwd()
    except FileNotFoundError:
        complain("the current folder has been removed; change to another one")
        raise SystemExit(2) from None
    try:
        with warnings_in_one_line(), at_work(shlex.join(["crosscheck", *sys.argv[1:2]])):
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
        code, message = _ending(error)
        complain(message)
        raise SystemExit(code) from None


def _ending(error: Exception) -> tuple[int, str]:
    """Exit code and line of an error that no command has taken."""
    if isinstance(error, CrosscheckError):
        return 2, str(error)
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] not in OWN:
        return 2, missing(error)
    if isinstance(error, OSError) and error.filename is not None:  # a disk, a folder, a right that the system refuses
        return 2, f"{error.filename}: {error.strerror}"
    from crosscheck.document.outcomes import INTERNAL

    *_, last = traceback.extract_tb(error.__traceback__)
    return INTERNAL, (f"internal error, a mistake of crosscheck: {named(error)} ({Path(last.filename).name}, line "
                      f"{last.lineno}); {REPORT}")


if __name__ == "__main__":
    main()
