"""One run for a study, which has to go on whatever the engine does."""

from __future__ import annotations

import traceback
from typing import Any

from crosscheck.errors import EngineError, Unsupported
from crosscheck.judge.verdict import Record
from crosscheck.scene.model import Scene


def attempt(scene: Scene, record: Record, form: str | None, step: float | None, rtol: float | None,
            **options: Any) -> Any:
    """A trajectory, or the one-line reason why there is none."""
    from crosscheck.running.run import run

    try:
        return run(scene, record.engine, record.method, step=step, rtol=rtol, form=form, **options)
    except Unsupported as error:
        record.outcome, record.message = "unsupported", str(error)
    except EngineError as error:
        return str(error)
    except Exception as error:
        # An adapter may meet anything inside a foreign engine; the record keeps it and the verdict fails.
        record.message = f"{type(error).__name__}: {error}"
        return record.message + "\n" + traceback.format_exc()
    return record.message
