"""What all types of the document have in common, and the way of a run, which many of them have."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Self, TypeVar

import msgspec


class Part(msgspec.Struct, frozen=True):
    """A part of the document. It cannot be changed; `msgspec.structs.replace` makes a changed copy."""


P = TypeVar("P", bound=Part)


def extended(kind: type[P], part: Part, **more: object) -> P:
    """A value of another type, with those fields of `part` that it has and with `more`."""
    shared = set(kind.__struct_fields__).intersection(part.__struct_fields__)
    return kind(**{name: getattr(part, name) for name in shared} | more)


Key = TypeVar("Key")
Value = TypeVar("Value")


def grouped(values: Iterable[Value], key: Callable[[Value], Key]) -> dict[Key, list[Value]]:
    """The values with the same key, in the order in which keys first appear."""
    groups: dict[Key, list[Value]] = {}
    for value in values:
        groups.setdefault(key(value), []).append(value)
    return groups


def set_words(options: Iterable[tuple[str, object]]) -> list[str]:
    """The words of a command line that ask for options of engines."""
    return [word for name, value in options if value is not None for word in (
        "--set", f"{name}={str(value).lower() if isinstance(value, bool) else value}")]


def size_of(each: Any) -> str:
    """Step (s) or relative tolerance in words, as every table and sentence has it; "" without one."""
    return f"{each.step:.3g} s" if each.step else f"rtol {each.rtol:.3g}" if each.rtol else ""


class Way(Part, frozen=True):
    """One way to run any scene: engine and method, step or rtol, and the options that are not the default."""

    engine: str
    method: str
    step: float | None = None  # s
    rtol: float | None = None
    form: str | None = None  # None: the engine chooses
    coordinate_map: str | None = None  # None: the default of the method
    options: tuple[tuple[str, Any], ...] = ()  # all others, by their names in `crosscheck.run`

    size = property(size_of)

    @classmethod
    def of(cls, engine: str, method: str, step: float | None = None, rtol: float | None = None, form: str | None = None,
           coordinate_map: str | None = None, **options: object) -> Self:
        """The way with those options that are not None."""
        return cls(engine, method, step, rtol, form, coordinate_map, tuple(
            (name, value) for name, value in options.items() if value is not None))

    def having(self, options: Mapping[str, Any]) -> Self:
        """This way with options of the engine, and without others."""
        others = tuple((name, value) for name, value in options.items() if name != "coordinate_map")
        return msgspec.structs.replace(self, coordinate_map=options.get("coordinate_map"), options=others)

    @property
    def settings(self) -> list[str]:
        """The options other than the map, in words."""
        return [f"{name} {value}" for name, value in self.options]

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of `crosscheck.run` after the method: step or rtol, and the options."""
        named = {name: getattr(self, name) for name in ("step", "rtol", "form", "coordinate_map")}
        return {name: value for name, value in named.items() if value is not None} | dict(self.options)

    @property
    def fineness(self) -> float:
        """A number that grows from coarse runs to fine ones."""
        return 1.0 / (self.step or self.rtol or math.inf)

    @property
    def label(self) -> str:
        """Engine, method, form and options."""
        named = ", ".join(filter(None, (self.form, self.coordinate_map, *self.settings)))
        return f"{self.engine} {self.method}" + (f" ({named})" if named else "")
