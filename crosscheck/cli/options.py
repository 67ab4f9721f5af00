"""Options shared by several commands, and numbers in their tables."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer

from crosscheck.errors import ArgumentError, unknown
from crosscheck.files import cache_folder, finite

if TYPE_CHECKING:
    from crosscheck.scene.model import Scene


Settings = Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE, an option of the engine's own, such as "
                                                    "reduce=off; may be repeated; a wrong key lists those that it has")]
MapSetting = Annotated[list[str] | None, typer.Option("--set", help="coordinate_map=exp, cayley or ccsk: from rotation "
                                                      "vectors to rotations, of engines that have this option")]
Step = Annotated[float | None, typer.Option(min=1e-9, help="s, of fixed-step methods; default: one that suits the scene"
                                            )]
Scheduler = Annotated[str | None, typer.Option(help="use a Dask scheduler, tcp://host:port, or another executor, "
                                               "module:factory; default: processes on this machine")]
Fresh = Annotated[bool, typer.Option(help="compute everything anew; default: where CI is set")]
Duration = Annotated[float | None, typer.Option(min=1e-6, help="s; default: the scene's")]
Jobs = Annotated[int, typer.Option(help="worker processes")]
TimeLimit = Annotated[float, typer.Option(help="s for one run and its order study")]
MemoryLimit = Annotated[float, typer.Option(help="GB resident of one worker process")]
Issue = Annotated[Path | None, typer.Option(help="write a text ready to file: versions, script, expected, observed")]
AsJson = Annotated[bool, typer.Option("--json", help="print everything as JSON")]

SceneNames = Annotated[list[str] | None, typer.Option("--scene", help="a built-in name or a path; may be repeated")]
Scenes = Annotated[list[str] | None, typer.Argument(help="scenes, as by --scene; default: those of the profile")]
EngineNames = Annotated[list[str] | None, typer.Option("--engine", help=(
    "a name, name==version, or a class of your own as module:Class or path/file.py:Class; may be repeated; "
    "default: all"))]
Engines = Annotated[list[str] | None, typer.Option("--engine", help="may be repeated; default: all")]


Page = Annotated[Path | None, typer.Option("-o", "--out", help="folder of a page")]
Drop = Annotated[bool, typer.Option("--drop", help="model files: leave out what a scene cannot hold")]
Control = Annotated[list[str] | None, typer.Option(
    help="model files: NAME=NUMBER of an actuator or its joint; may be repeated")]
Limits = Annotated[str, typer.Option(
    help="model files: monitor, the scene holds until a joint reaches one; keep, rigid stops; or drop")]
SceneName = Annotated[str, typer.Argument(help="a built-in name, a path to .toml or .json, or a model, .xml or .urdf")]


class Start(NamedTuple):
    """Where a model file starts: its keyframe, and what overrides it, as `crosscheck.import_model` has them."""

    keyframe: Annotated[str | None, typer.Option(help="model files: start from this keyframe")] = None
    qpos: Annotated[str | None, typer.Option(help="model files: start here, .2,.4,.5: coordinates of joints in file "
                                             "order, of a free base its position and quaternion w,x,y,z")] = None
    qvel: Annotated[str | None, typer.Option(help="model files: with these velocities, of joints in file order")] = None

    @property
    def given(self) -> dict[str, Any]:
        """As arguments of `crosscheck.import_model`; raises `ArgumentError` for what is no numbers."""
        return {"keyframe": self.keyframe, "qpos": _numbers("--qpos", self.qpos),
                "qvel": _numbers("--qvel", self.qvel)}

    @property
    def words(self) -> list[str]:
        """As they are written in a command."""
        return [word for key, value in self._asdict().items() if value is not None for word in (f"--{key}", value)]


REFERENCE = Start()
"""That of the model itself, at rest."""


def _numbers(option: str, text: str | None) -> list[float] | None:
    try:
        return None if text is None else [float(each) for each in text.replace(",", " ").split()]
    except ValueError:
        raise ArgumentError(f"{option}: {text!r} is not a list of numbers, such as .2,.4,.5") from None


def starting(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of a `Start` in place of its argument `at`."""
    def asked(*positional: Any, **named: Any) -> None:
        given = {key: named.pop(key) for key in Start._fields if key in named}
        command(*positional, **named, **({"at": Start(**given)} if given else {}))

    hints = get_type_hints(command, include_extras=True)
    own = [each.replace(annotation=hints[each.name]) for each in inspect.signature(command).parameters.values()]
    told = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=hint)
            for name, hint in get_type_hints(Start, include_extras=True).items()]
    place = next(k for k, each in enumerate(own) if each.name == "at")
    every = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (*own[:place], *told, *own[place + 1:])]
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
            raise ArgumentError(f"--set: {name} is no option of the engine's own; give --{name}")
        try:
            read[name] = text == "true" if text in ("true", "false") else float(text)
        except ValueError:
            read[name] = text
    return read


def coordinate_map(given: Iterable[str] | None) -> str | None:
    """The map for runs of many engines, which take no other option of an engine's own; raises `ArgumentError`."""
    from crosscheck.adapters.base import CHOICES

    for name, value in settings(given).items():
        if name != "coordinate_map":
            raise ArgumentError(unknown("--set", name, ("coordinate_map",)) + "; crosscheck run has the others")
        if value not in CHOICES[name]:
            raise ArgumentError(unknown(f"--set {name}", value, CHOICES[name]))
        return str(value)
    return None


def controls(given: Iterable[str] | None) -> dict[str, float]:
    """The numbers of NAME=NUMBER by name."""
    return dict(named_number("--control", each, "elbow=0.3") for each in given or ())


def loaded(name: str, drop: bool, at: Start, control: Iterable[str] | None = None, limits: str = "monitor") -> Scene:
    """The scene of a name, a scene file or a model file; prints what is left out of a model."""
    from crosscheck.scene.file import load_scene
    from crosscheck.scene.models import import_model, is_model

    if not is_model(name):
        if drop or any(at) or control or limits != "monitor":
            raise ArgumentError("--drop, --keyframe, --qpos, --qvel, --control and --limits go with a model file, .xml "
                                f"or .urdf, not with {name}")
        return load_scene(name)
    scene = import_model(name, drop=drop, controls=controls(control), limits=limits,  # type: ignore[arg-type]
                         **at.given)
    _say_left_out(name, scene)
    return scene


def _say_left_out(name: str, scene: Scene) -> None:
    from crosscheck.scene.models.words import shortened

    for words in shortened(scene.left_out):
        typer.echo(f"left out of {name}: {words}", err=True)


def scene_files(names: Iterable[str] | None, drop: bool, at: Start, control: Sequence[str] | None = None,
                limits: str = "monitor") -> list[str] | None:
    """The names, with every model file replaced by its scene file, which is written to the cache folder."""
    from crosscheck.scene.models import import_file, is_model

    if names is None:
        return None
    files = []
    for name in names:
        if not is_model(name):
            files.append(name)
            continue
        key = hashlib.sha256(repr((os.path.abspath(name), drop, at, control, limits)).encode()).hexdigest()[:12]
        target = cache_folder() / "models" / key / f"{Path(name).stem}.toml"
        target.parent.mkdir(parents=True, exist_ok=True)
        scene = import_file(name, target, drop=drop, controls=controls(control), limits=limits, **at.given)
        _say_left_out(name, scene)
        files.append(str(target))
    return files


def model_words(drop: bool, at: Start, control: Sequence[str] | None, limits: str) -> list[str]:
    """The options of a model file as they are written in a command."""
    return [*(["--drop"] if drop else []), *at.words, *(word for each in control or () for word in ("--control", each)),
            *(["--limits", limits] if limits != "monitor" else [])]


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
        return name.strip(), float(number)
    except ValueError:
        raise ArgumentError(f"{option}: {text!r} is not NAME=NUMBER, such as {example}") from None


def chosen(names: Iterable[str] | None) -> tuple[str, ...] | None:
    """Names in the form that studies take; None means all."""
    return tuple(names) if names else None


FORMATS = ("text", "github")

Format = Annotated[str, typer.Option("--format", callback=lambda given: _format(given),
                                     help="text, or github: besides, annotations of a workflow")]


def _format(given: str) -> str:
    if given not in FORMATS:
        raise ArgumentError(unknown("--format", given, FORMATS))
    return given


def figure(value: float | None, missing: str = "", digits: str = ".3g") -> str:
    """A number with three digits, or in the given format."""
    return missing if value is None else format(value, digits)


def figures(values: Iterable[float | None], missing: str = "", digits: str = ".3g") -> Iterator[str]:
    """`figure` of each number."""
    return (figure(value, missing, digits) for value in values)
