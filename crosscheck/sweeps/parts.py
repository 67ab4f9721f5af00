"""The results of sweeps on the disk: Parquet files in a folder. Each is written as a whole or not at all."""

from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import astuple

from crosscheck.errors import ArgumentError
from crosscheck.files import replacing
from crosscheck.sweeps.cells import FIGURES, Row

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = Row.__struct_fields__
MOST_ROWS = 2000
PERIOD = 2.0
"""Longest time (s) before new rows are written. If the process is killed, the rows of this time are lost."""


class Parts:
    """The finished cells of a folder. New rows can be added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "parts"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArgumentError(f"{folder}: cannot be made ({error.strerror or error}); name another folder") from None
        self._waiting: list[Row] = []
        self._written = time.monotonic()

    def finished(self) -> set[str]:
        """Keys of the cells in the folder."""
        return set(self._read(["cell"])["cell"])

    def frame(self) -> pd.DataFrame:
        """All rows in the folder, one per cell."""
        return self._read(list(COLUMNS)).drop_duplicates("cell", keep="first")

    def add(self, rows: list[Row]) -> None:
        """Add rows. They are written when there are many, or when `PERIOD` has passed."""
        self._waiting += rows
        if len(self._waiting) >= MOST_ROWS or time.monotonic() - self._written > PERIOD:
            self.flush()

    def flush(self) -> None:
        """Write all rows that are not on the disk yet."""
        import pandas as pd

        self._written = time.monotonic()
        if not self._waiting:
            return
        frame = pd.DataFrame(map(astuple, self._waiting), columns=list(COLUMNS)).astype(
            dict.fromkeys(("step", "rtol", *FIGURES, "wall_time"), "float64"))
        try:
            with replacing(self.folder / f"{uuid.uuid4().hex}.parquet") as aside:
                frame.to_parquet(aside, index=False)
        except OSError as error:
            raise ArgumentError(f"{self.folder}: {error.strerror or error}; mend this and start the sweep again, what "
                                "was written before is kept") from None
        self._waiting = []

    def _read(self, columns: list[str]) -> pd.DataFrame:
        import pandas as pd

        frames = []
        for path in sorted(self.folder.glob("*.parquet")):
            try:
                frames.append(pd.read_parquet(path, columns=columns))
            except Exception as error:
                raise ArgumentError(f"{path}: not a part of a sweep ({error}); remove it") from None
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)
