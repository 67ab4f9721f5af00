"""The folder of a study: JSON, CSV and, where it has one, a page. Files are replaced as a whole, never in part."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from crosscheck.errors import ArgumentError


def check(out: Path, study: str) -> None:
    """Raise `ArgumentError` unless the folder is new, empty, or holds an earlier run of this study; create it.

    Parameters
    ----------
    out : the folder
    study : name of the study, which is that of its files
    """
    try:
        if out.is_dir() and any(out.iterdir()) and not (out / f"{study}.json").is_file():
            raise ArgumentError(f"--out {out}: this folder holds something else than a study {study}; choose an empty "
                                "folder or one that does not exist yet")
        out.mkdir(parents=True, exist_ok=True)
        _put(out / ".writable", "")
        (out / ".writable").unlink()
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}; choose another folder") from None


def write(out: Path, document: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], page: str | None = None) -> None:
    """Write <study>.json, <study>.csv of its rows and, with a page, index.html and plotly.min.js beside it.

    Numbers that are not finite become null, and empty cells.
    """
    study = document["study"]
    document = _finite(document)
    _put(out / f"{study}.json", json.dumps(document, indent=1, allow_nan=False))
    table = io.StringIO()
    if rows:
        writer = csv.DictWriter(table, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(_finite(list(rows)))
    _put(out / f"{study}.csv", table.getvalue())
    if page is not None:
        import plotly.offline

        from crosscheck.report.pages import _environment as environment

        text = environment().get_template(page).render(document=document)
        _put(out / "plotly.min.js", plotly.offline.get_plotlyjs())
        _put(out / "index.html", text)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _put(path: Path, text: str) -> None:
    aside = path.with_name(f".{path.name}.new")
    aside.write_text(text, encoding="utf-8")
    os.replace(aside, path)
