"""Checks of arguments. Each returns the checked value or raises ArgumentError, which names argument and requirement.

Types at the end carry them: a field of such a type is checked where its class is derived from `Frozen`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
from collections.abc import Callable
from types import UnionType
from typing import Annotated, Any, SupportsFloat, Union, get_args, get_origin, get_type_hints

import numpy as np

from lieeuler.errors import ArgumentError
from lieeuler.types import ArrayLike

LARGEST = 1e100
"""Largest magnitude accepted: a product of three such numbers is still a finite double."""

SMALLEST = 1 / LARGEST
"""Smallest mass, moment of inertia, rod length, step or tolerance accepted, so that its reciprocal stays in range."""


def vector(name: str, value: ArrayLike) -> np.ndarray:
    """Three numbers, read-only."""
    return array(name, value, (3,))


def unit(name: str, value: ArrayLike) -> np.ndarray:
    """A vector of length one in the given direction."""
    direction = vector(name, value)
    largest = np.abs(direction).max()
    if largest == 0:
        raise ArgumentError(f"{name} must not vanish")
    direction = direction / largest  # squares of very small numbers would vanish
    unit: np.ndarray = direction / np.linalg.norm(direction)
    return unit


def number(name: str, value: float, lowest: float | None = None) -> float:
    """A number up to LARGEST, not below `lowest` where that is given."""
    bound = "" if lowest is None else f", not below {lowest:g}"
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ArgumentError(f"{name} must be a number{bound}, not {value!r}")
    plain = _double(value)
    if not math.isfinite(plain) or (lowest is not None and plain < lowest):
        raise ArgumentError(f"{name} must be finite{bound}, not {value!r}")
    if abs(plain) > LARGEST:
        raise ArgumentError(f"{name} is {plain:g}, out of range; take a number up to {LARGEST:g}")
    return plain


def positive(name: str, value: float) -> float:
    """A number between SMALLEST and LARGEST."""
    bounded = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if bounded and not (math.isfinite(_double(value)) and value > 0):
        raise ArgumentError(f"{name} must be positive and finite, not {value!r}")
    plain = number(name, value)
    if plain < SMALLEST:
        raise ArgumentError(f"{name} is {plain:g}, out of range; take a number above {SMALLEST:g}")
    return plain


def _double(value: SupportsFloat) -> float:
    """The nearest double; infinity for an integer or a fraction beyond the range of doubles."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Real numbers up to LARGEST of the given shape, read-only and contiguous."""
    values = real(value)
    if values is None:
        raise ArgumentError(f"{name} must be numbers of shape {shape}, not {value!r}")
    if values.shape != shape or not np.isfinite(values).all():
        raise ArgumentError(f"{name} must be finite and of shape {shape}, not {values.shape}")
    if np.abs(values).max(initial=0.0) > LARGEST:
        raise ArgumentError(f"{name} holds a number above {LARGEST:g}, which is out of range")
    values.setflags(write=False)
    return values


def real(value: ArrayLike) -> np.ndarray | None:
    """A copy as doubles, or None if an entry is not a real number: NumPy would convert text and complex numbers."""
    try:
        plain = np.asarray(value)
        if plain.dtype.kind not in "iufO" or np.ma.is_masked(value):
            return None
        if plain.dtype.kind == "O" and not all(isinstance(entry, numbers.Real) for entry in plain.flat):
            return None
        return np.array(plain, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        return None


def body_index(name: str, value: int) -> int:
    """A whole number. `Problem` checks that a body of this index exists."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise ArgumentError(f"{name} must be the index of a body (-1 for the ground), not {value!r}")
    return int(value)


def rotation(name: str, value: ArrayLike) -> np.ndarray:
    """A rotation matrix (3, 3)."""
    R = array(name, value, (3, 3))
    if not np.abs(R.T @ R - np.eye(3)).max() < 1e-10 or np.linalg.det(R) < 0:
        raise ArgumentError(f"{name} must be a rotation matrix, 3 x 3")
    return R


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b over the last axis, with broadcasting; `numpy.cross` takes several times longer on small arrays."""
    (a1, a2, a3), (b1, b2, b3) = ([each[..., k] for k in range(3)] for each in (a, b))
    first = a2 * b3 - a3 * b2
    product = np.empty((*first.shape, 3))
    product[..., 0], product[..., 1], product[..., 2] = first, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1
    return product


def normals(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors n1, n2 with n1 x n2 = axis, a unit vector (3,).

    n1 is the coordinate direction along which the axis has its smallest component (the first of equal ones), made
    normal to the axis. This is well conditioned for every axis.
    """
    n1 = np.eye(3)[np.argmin(np.abs(axis))]
    n1 = n1 - (n1 @ axis) * axis
    n1 /= np.linalg.norm(n1)
    return n1, cross(axis, n1)


def flag(name: str, value: bool) -> bool:
    """True or False."""
    if not isinstance(value, bool):
        raise ArgumentError(f"{name} must be True or False, not {value!r}")
    return value


def one_of(*words: str) -> Callable[[str, str], str]:
    """The check whether a value is one of these words."""
    def check(name: str, value: str) -> str:
        if not isinstance(value, str) or value not in words:
            raise ArgumentError(f"{name} must be one of {', '.join(words)}, not {value!r}")
        return value
    return check


Index = Annotated[int, body_index]
Flag = Annotated[bool, flag]
Number = Annotated[float, number]
NonNegative = Annotated[float, functools.partial(number, lowest=0.0)]
Positive = Annotated[float, positive]
Vector = Annotated[np.ndarray, vector]
Unit = Annotated[np.ndarray, unit]
Rotation = Annotated[np.ndarray, rotation]


@functools.cache
def _checks(cls: type) -> tuple[tuple[str, Callable[[str, Any], Any], bool], ...]:
    """Fields whose types carry a check, the check, and whether they may be None."""
    found, hints = [], get_type_hints(cls, include_extras=True)
    for field in dataclasses.fields(cls):
        kinds = _united(hints[field.name])
        for kind in kinds:
            item = get_args(kind)[0] if get_origin(kind) is tuple else kind
            if hasattr(kind, "__metadata__"):
                found.append((field.name, kind.__metadata__[0], type(None) in kinds))
            elif all(isinstance(each, type) and issubclass(each, Frozen) for each in _united(item)):
                check = _instance if kind is item else _items
                found.append((field.name, functools.partial(check, item), type(None) in kinds))
    return tuple(found)


def _united(hint: Any) -> tuple[Any, ...]:
    """The types of a union, or the one type."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _instance(kind: type, name: str, value: object) -> object:
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be a lieeuler.{kind.__name__}, not {value!r}")
    return value


def _items(kind: type, name: str, value: Any) -> tuple[object, ...]:
    try:
        items = tuple(value)
    except TypeError:
        raise ArgumentError(f"{name} must be a sequence, not {value!r}") from None
    for k, item in enumerate(items):
        if not isinstance(item, kind):
            raise ArgumentError(f"{name}[{k}] is of another kind: {item!r}")
    return items


class Frozen:
    """Base of frozen dataclasses: fields whose types carry a check, or are such classes themselves, are checked.

    A copy or pickle holds the fields, arrays read-only, but no cached values.
    """

    def __post_init__(self) -> None:
        for name, check, optional in _checks(type(self)):  # type: ignore[arg-type]
            if not (optional and getattr(self, name) is None):
                object.__setattr__(self, name, check(name, getattr(self, name)))

    def __getstate__(self) -> dict[str, object]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]

    def __setstate__(self, state: dict[str, object]) -> None:
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)
