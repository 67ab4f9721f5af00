"""One run for a study. A failure of the engine must not end the study."""

from __future__ import annotations

import dataclasses
from typing import Any

from crosscheck.errors import EngineError, Unsupported
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene


@dataclasses.dataclass(frozen=True)
class NoRun:
    """Why there is no trajectory, in one line."""

    reason: str
    unsupported: bool = False  # the engine does not support the run
    unforeseen: bool = False  # an error that adapters should not raise


def attempt(scene: Scene, engine: str, method: str, form: str | None, step: float | None, rtol: float | None,
            **options: Any) -> Trajectory | NoRun:
    """A trajectory, or the reason why there is none."""
    from crosscheck.running.run import run

    try:
        return run(scene, engine, method, step=step, rtol=rtol, form=form, **options)
    except Unsupported as error:
        return NoRun(str(error), unsupported=True)
    except EngineError as error:
        return NoRun(str(error).partition("\n")[0])
    except Exception as error:
        # Whatever the engine raises is written to the record, and the verdict fails.
        return NoRun(f"{type(error).__name__}: {error}", unforeseen=True)
