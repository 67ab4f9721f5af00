"""Independent truth: a motion by one formulation, and what it leaves in the equations of another.

Nothing here imports `lieeuler` or an adapter. The motion is a Taylor series in minimal coordinates; the index-1
equations in maximal coordinates, of `crosscheck.scene`, are evaluated along it on every piece at once (`defects`).
Neither formulation reads the formulas of the other. Where heyoka is not installed the second one makes the motion,
and is compared with itself at other nodes.

Force laws of joints make a motion smooth only in pieces: `pieces` finds where one ends, `modes` says what may follow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from crosscheck.errors import Unsupported
from crosscheck.references.base import Chaotic, Reference, TruthError
from crosscheck.references.tree import bound, unfold
from crosscheck.scene.laws import FORCE_TYPES
from crosscheck.scene.model import ACTS, ELEMENTS, Scene

if TYPE_CHECKING:
    import pathlib

    from crosscheck.references.dense_output import Truth

__all__ = ["Chaotic", "Reference", "TruthError", "dense", "truth"]

KEPT = 4
"""Number of truths that a process keeps in memory, those used last."""

_kept: dict[pathlib.Path, tuple[object, Truth]] = {}


def truth(scene: Scene) -> Reference:
    """Reference trajectory of a scene: its `dense` truth at its output times.

    Raises
    ------
    TruthError
        The formulations differ so much that no usable digits are left, or the motion ends early, as it does where the
        rows of a loop lose rank, except in parallelograms. The error is `Chaotic`, with the `horizon` of the truth, if
        that is before the first output time.
    Unsupported
        The scene has elements that the references do not model.
    """
    return dense(scene).reference(scene)


def dense(scene: Scene) -> Truth:
    """Truth of the system of a scene at any time, at least over the scene's duration, from the cache if it is there.

    There is one computation, and one file, for each system (`Scene.key`), whatever durations and samples are asked of
    it. A longer time prolongs it.

    Raises
    ------
    TruthError, Unsupported
        As `truth`, without `Chaotic`.
    """
    from crosscheck.references import cache

    _refuse(scene)
    file = cache.path(scene)
    stamp, kept = _kept.pop(file, (None, None))
    if kept is None or stamp != _stamp(file):
        kept = cache.load(scene, portable=not _compiles()) or _truth_of(scene)
    kept.scene = scene  # for its name
    kept.keep = _store
    if kept.prolong(scene.duration):
        _store(kept)
    _kept[file] = _stamp(file), kept
    while len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    return kept


def compute(scene: Scene) -> Reference:
    """As `truth`, without the cache; if heyoka is not installed, from the formulation that does not need it."""
    return _truth_of(scene).reference(scene)


def _truth_of(scene: Scene) -> Truth:
    from crosscheck.references.dense_output import Truth

    return Truth(scene, portable=not _compiles())


def _compiles() -> bool:
    """Whether heyoka is installed."""
    try:
        import heyoka  # noqa: F401
    except ImportError:
        return False
    return True


def _store(kept: Truth) -> None:
    """Store a truth, and note that the one in memory is that of the file."""
    from crosscheck.references import cache

    cache.store(kept)
    file = cache.path(kept.scene)
    if file in _kept:
        _kept[file] = _stamp(file), kept


def _stamp(file: pathlib.Path) -> object:
    """What changes if a file is replaced or edited; None without one."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def _refuse(scene: Scene) -> None:
    """Raise `Unsupported` for elements that the references do not model."""
    if acting := [str(each).removeprefix(ACTS) for each in scene.left_out if each.what.startswith(ACTS)]:
        raise Unsupported(f"truth of {scene.name!r}: it holds until something acts that was left out, which is at the "
                          f"start: {'; '.join(acting[:3])}{f' and {len(acting) - 3} more' if len(acting) > 3 else ''}")
    if reason := scene.beyond((*ELEMENTS, *FORCE_TYPES)):
        raise Unsupported(f"truth of {scene.name!r}: {reason}")
    refused = [joint for joint in scene.joints if bound(scene, joint)]
    if refused and (closing := [joint.name for joint in unfold(scene)[1] if joint in refused]):
        raise Unsupported(f"truth of {scene.name!r}: armature, mimics and laws of joint {closing[0]!r} are not built "
                          "where every joint of a loop has some, or is on a frame")
