"""Options shared by several commands, and numbers in their tables."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer

from crosscheck.cli.console import progress_bar
from crosscheck.errors import ArgumentError, unknown
from crosscheck.files import finite

if TYPE_CHECKING:
    from crosscheck.scene.model import Scene


Settings = Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE, an option of this engine, such as "
                                                    "reduce=off; may be repeated; an unknown key lists all")]
SharedSettings = Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE, for the engines that have such an "
                                                          "option, such as softness=tight; may be repeated")]
Step = Annotated[float | None, typer.Option(min=1e-9, help="s, of fixed-step methods; default: chosen for the scene")]
Scheduler = Annotated[str | None, typer.Option(help="use a Dask scheduler, tcp://host:port, or another executor, "
                                               "module:factory; default: processes on this machine")]
Need = Annotated[float, typer.Option(min=0.0, max=1.0, help="share of its time over which the motion of a run has "
                                     "to be judged for it to pass")]
Fresh = Annotated[bool, typer.Option(help="take no results of earlier runs; default: where CI is set")]
Duration = Annotated[float | None, typer.Option(min=1e-6, help="s; default: the scene's")]
Jobs = Annotated[int, typer.Option(help="worker processes")]
TimeLimit = Annotated[float, typer.Option(help="s for one run and its verdict")]
MemoryLimit = Annotated[float, typer.Option(help="GB of memory of one worker process")]
Issue = Annotated[Path | None, typer.Option(help="write a text ready to file: the script, what it expects and, of "
                                            "bisect, what was observed")]
AsJson = Annotated[bool, typer.Option("--json", help="print everything as JSON")]

SceneNames = Annotated[list[str] | None, typer.Option("--scene", help="a built-in name or a path; may be repeated")]
Scenes = Annotated[list[str] | None, typer.Argument(help="scenes, as by --scene; default: those of the profile")]
EngineNames = Annotated[list[str] | None, typer.Option("--engine", help=(
    "a name, name==version, a class of your own, module:Class or path/file.py:Class, or a program, "
    "\"order=4 ./program {scene} {step} {out}\"; may be repeated; default: all"))]
Engines = Annotated[list[str] | None, typer.Option("--engine", help="may be repeated; default: all")]
Page = Annotated[Path | None, typer.Option("-o", "--out", help="folder of a page")]
SceneName = Annotated[str, typer.Argument(help="a built-in name, a path to .toml or .json, or a model, .xml or .urdf")]


FORM = "how the scene is modelled: tree (joint coordinates), maximal (free bodies with constraints) or pivot; default: "
"""What --form chooses; what follows says who chooses where it is not given."""


class Reading(NamedTuple):
    """How a model file is read: what is left out, and its start, as `crosscheck.import_model` has them."""

    drop: Annotated[bool, typer.Option(
        "--drop", help="model files: leave out, and list, what a scene cannot represent")] = False
    keyframe: Annotated[str | None, typer.Option(help="model files: start from this keyframe")] = None
    qpos: Annotated[str | None, typer.Option(
        help="model files: start here, such as .2,.4,.5: coordinates of joints in file order, of a free base its "
             "position and quaternion w,x,y,z")] = None
    qvel: Annotated[str | None, typer.Option(help="model files: with these velocities, of joints in file order")] = None
    control: Annotated[list[str] | None, typer.Option(
        help="model files: NAME=NUMBER of an actuator or its joint; may be repeated")] = None
    limits: Annotated[str, typer.Option(
        help="model files: monitor, the scene ends when a joint reaches a limit; keep, limits are rigid stops; or "
             "drop")] = "monitor"

    @property
    def start(self) -> dict[str, Any]:
        """The start as arguments of `crosscheck.import_model`; raises `ArgumentError` for what is no numbers."""
        return {"keyframe": self.keyframe, "qpos": _numbers("--qpos", self.qpos),
                "qvel": _numbers("--qvel", self.qvel)}

    @property
    def given(self) -> dict[str, Any]:
        """All as arguments of `crosscheck.import_model`."""
        controls = dict(named_number("--control", each, "elbow=0.3") for each in self.control or ())
        return {"drop": self.drop, "controls": controls or None, "limits": self.limits, **self.start}

    @property
    def words(self) -> list[str]:
        """As they are written in a command."""
        return [word for name, value in self._asdict().items() if value and value != self._field_defaults[name]
                for each in (value if isinstance(value, list) else [value])
                for word in ([f"--{name}"] if each is True else [f"--{name}", each])]

    def only_start(self) -> dict[str, Any]:
        """The start, for scripts, which take a model file as it is; raises `ArgumentError` where more is asked for."""
        if self != Reading(keyframe=self.keyframe, qpos=self.qpos, qvel=self.qvel):
            raise ArgumentError("--drop, --control, --limits: a script takes the model file as it is; leave them out")
        return self.start


AS_IT_IS = Reading()
"""Of what a scene can hold, all, from the start of the model itself, at rest."""


def _numbers(option: str, text: str | None) -> list[float] | None:
    try:
        return None if text is None else [float(each) for each in text.replace(",", " ").split()]
    except ValueError:
        raise ArgumentError(f"{option}: {text!r} is not a list of numbers, such as .2,.4,.5") from None


def reads_models(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of a `Reading` in place of its argument `reading`."""
    def asked(*positional: Any, **named: Any) -> None:
        given = {key: named.pop(key) for key in Reading._fields if key in named}
        command(*positional, **named, **({"reading": Reading(**given)} if given else {}))

    hints = get_type_hints(command, include_extras=True)
    own = [each.replace(annotation=hints[each.name]) for each in inspect.signature(command).parameters.values()]
    added = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=Reading._field_defaults[name],
                              annotation=hint) for name, hint in get_type_hints(Reading, include_extras=True).items()]
    place = next(k for k, each in enumerate(own) if each.name == "reading")
    every = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (*own[:place], *added, *own[place + 1:])]
    asked.__name__, asked.__doc__ = command.__name__, command.__doc__
    asked.__annotations__ = {each.name: each.annotation for each in every}
    vars(asked)["__signature__"] = inspect.Signature(every)
    return asked


def settings(given: Iterable[str] | None) -> dict[str, Any]:
    """The engine's own options, which are checked where the engine is known; raises `ArgumentError`."""
    read: dict[str, Any] = {}
    for each in given or ():
        name, _, text = each.partition("=")
        if not name or not text:
            raise ArgumentError(f"--set: {each!r} is not KEY=VALUE, such as reduce=off")
        if name in ("method", "step", "rtol", "form", "samples", "duration"):
            raise ArgumentError(f"--set: {name} is no option of the engine's own; commands in which it can be chosen, "
                                f"such as run, take --{name}")
        try:
            read[name] = text.lower() == "true" if text.lower() in ("true", "false") else float(text)
        except ValueError:
            read[name] = text
    return read


def shared(given: Iterable[str] | None) -> tuple[tuple[str, Any], ...]:
    """The same for runs of many engines."""
    return tuple(settings(given).items())


def loaded(name: str, reading: Reading) -> Scene:
    """The scene of a name, a scene file or a model file; prints what is left out of a model."""
    from crosscheck.scene.file import load_scene
    from crosscheck.scene.models import import_model, is_model
    from crosscheck.scene.models.words import shortened

    if not is_model(name):
        if reading != AS_IT_IS:
            raise ArgumentError("--drop, --keyframe, --qpos, --qvel, --control and --limits go with a model file, .xml "
                                f"or .urdf, not with {name}")
        return load_scene(name)
    with progress_bar(f"reading {name}"):
        scene = import_model(name, **reading.given)
    for words in shortened(scene.left_out):
        typer.echo(f"left out of {name}: {words}", err=True)
    return scene


def sensors(name: str) -> list[str] | None:
    """Names of a scene's sensors, before it is prepared; None of a model file that may have some."""
    from crosscheck.scene.file import as_scene
    from crosscheck.scene.models import is_model

    if not is_model(name):
        return [sensor.name for sensor in as_scene(name).sensors]
    text = Path(name).read_bytes() if Path(name).is_file() else b""
    return None if b"sensor" in text or b"include" in text else []


def scenes(default: str) -> object:
    """The argument for scenes; `default` describes the default."""
    return typer.Argument(help=f"names or paths; default: {default}")


def methods(default: str) -> object:
    """The option for methods; `default` describes the default."""
    return typer.Option("--method", help=f"may be repeated; default: {default}")


def time_limit(consequence: str) -> Any:
    """The time limit of one run; `consequence` says what happens to longer ones."""
    return typer.Option(min=1e-3, help=f"s of one run; {consequence}")


def print_json(values: object) -> None:
    """Print a document as JSON, in which numbers that are not finite are null."""
    typer.echo(json.dumps(finite(values), indent=1))


def named_number(option: str, text: str, example: str) -> tuple[str, float]:
    """The name and the number of an option NAME=NUMBER. Raises `ArgumentError` if it is none."""
    name, _, number = text.rpartition("=")
    try:
        if name.strip():
            return name.strip(), float(number)
    except ValueError:
        pass
    raise ArgumentError(f"{option}: {text!r} is not NAME=NUMBER, such as {example}")


def chosen(names: Iterable[str] | None) -> tuple[str, ...] | None:
    """Names in the form that studies take; None means all."""
    return tuple(names) if names else None


def among(option: str, *allowed: str) -> Callable[[str | None], str | None]:
    """The check of an option that is one of some words, if it is given."""
    def checked(given: str | None) -> str | None:
        if given is not None and given not in allowed:
            raise ArgumentError(unknown(option, given, allowed))
        return given
    return checked


Format = Annotated[str, typer.Option("--format", callback=among("--format", "text", "github"),
                                     help="text, or github: besides, annotations of a workflow")]


def figure(value: float | None, missing: str = "", digits: str = ".3g") -> str:
    """A number with three digits, or in the given format."""
    return missing if value is None else format(value, digits)


def figures(values: Iterable[float | None], missing: str = "", digits: str = ".3g") -> Iterator[str]:
    """`figure` of each number."""
    return (figure(value, missing, digits) for value in values)
