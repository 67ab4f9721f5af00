"""Write and read results.json with the types of `crosscheck.document`, and make its JSON Schema of them.

Unknown keys are ignored, because a newer version may write more.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from crosscheck import files
from crosscheck.document import SCHEMA, Document, curves
from crosscheck.errors import ArgumentError


def plain(document: Document) -> dict[str, Any]:
    """The content of results.json: only types that JSON has, and no curves, which are in other files."""
    bare = replace(document, scenes=[replace(scene, curves=curves.SceneCurves()) for scene in document.scenes],
                   records=[replace(record, curves=curves.RunCurves()) for record in document.records])
    values = files.plain(bare)
    for each in (*values["scenes"], *values["records"]):
        each.pop("curves", None)
    return dict(values)


def from_plain(values: object) -> Document:
    """The document from values that `plain` made.

    Raises `msgspec.ValidationError`, which says what is wrong.
    """
    if not isinstance(values, dict) or values.get("schema") != SCHEMA:
        version = values.get("schema") if isinstance(values, dict) else None
        raise msgspec.ValidationError(f"schema {version!r} is not {SCHEMA}")
    return msgspec.convert(values, Document, str_keys=True)


def read_document(path: Path) -> Document:
    """The content of a results.json. Raises `ArgumentError`, which names the file and says what is wrong."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArgumentError(f"{path}: cannot be read ({error.strerror}); name a folder that `crosscheck verify` wrote"
                            ) from None
    except ValueError as error:
        raise ArgumentError(f"{path}: no JSON ({error})") from None
    try:
        return from_plain(values)
    except msgspec.ValidationError as error:
        raise ArgumentError(f"{path}: not a results.json of this version ({error}); run `crosscheck verify` again"
                            ) from None


def json_schema() -> dict[str, object]:
    """The JSON Schema of results.json, without the curves, which are in other files."""
    (document,), definitions = msgspec.json.schema_components([Document], ref_template="#/$defs/{name}")
    for name in ("Scene", "Record"):
        definitions[name]["properties"].pop("curves")
    for name, kind in vars(curves).items():
        if isinstance(kind, type) and kind.__module__ == curves.__name__:
            definitions.pop(name, None)
    definitions["Document"]["properties"]["schema"] = {"const": SCHEMA}
    whole = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "results.json of crosscheck verify",
             **document, "$defs": definitions}
    return dict(json.loads(json.dumps(whole)))  # defaults are tuples
