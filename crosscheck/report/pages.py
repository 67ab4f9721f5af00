"""The pages: each gets its part of the document. Texts and numbers are shown as the document has them."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import urllib.parse
from pathlib import Path
from typing import Any

import msgspec

from crosscheck.document import LEVELS, QUANTITIES, Document, Record, Scene
from crosscheck.document.outcomes import worst
from crosscheck.files import cache_folder
from crosscheck.report import overview
from crosscheck.report.headline import (
    OUTCOMES,
    advice,
    answers,
    assumptions,
    ending,
    headline,
    number,
    plain_number,
    sentence,
    shade,
    share_words,
    span,
    spoken,
    tolerances,
    visible_error,
    within,
)
from crosscheck.report.identity import for_scripts

STUDIES = {"convergence": "Convergence", "speed": "Speed against error", "conservation": "Energy and constraints"}
"""Titles of the studies by the keys in their file names."""


def slug(text: str) -> str:
    """Text as a part of a file name or an anchor."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-") or "scene"


def anchor(record: Record) -> str:
    """The anchor of a run on the page of its scene."""
    return slug(f"run {record.label}")


def _part(name: str) -> str:
    """A name as a part of a file name. Different names give different parts.

    For this, a part of a checksum is added to names that lose letters, such as paths, and to names with capital
    letters, which some file systems ignore.
    """
    part = slug(Path(name).stem if name.endswith((".toml", ".json")) else name)
    if part == name == name.lower():
        return part
    return f"{part}-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def scene_file(scene: Scene) -> str:
    """File name of a scene's page."""
    return f"scene-{_part(scene.name)}.html"


def data_file(scene: Scene) -> str:
    """File name of a scene's curves."""
    return f"scene-{_part(scene.name)}.js"


def engine_file(name: str) -> str:
    """File name of an engine's page."""
    return f"engine-{_part(name)}.html"


def study_file(key: str) -> str:
    """File name of a study's page."""
    return f"study-{key}.html"


HERE = Path(__file__).resolve().parent
LISTED = 5
"""Most runs that summary.md names for a group of findings."""
FORCE_UNITS = {
    "stiffness": {"torsional_spring": "N m/rad", "any": "N/m"},
    "damping": {"torsional_spring": "N m s/rad", "any": "N s/m"},
    "free_length": {"any": "m"}, "rest_angle": {"any": "rad"},
    "rest_position": {"any": "m"}, "force": {"any": "N"}, "torque": {"any": "N m"},
    "frame": {"any": "frame"}}
"""Units of force parameters by type of force; "any" is for all other types."""


@functools.cache
def environment() -> Any:
    """The Jinja environment with templates, filters and constants of the pages; each template is compiled once."""
    import jinja2

    compiled = cache_folder() / "templates"
    try:
        compiled.mkdir(parents=True, exist_ok=True)
        cache = jinja2.FileSystemBytecodeCache(str(compiled)) if os.access(compiled, os.W_OK) else None
    except OSError:  # a home that nobody may write to
        cache = None
    made = jinja2.Environment(
        bytecode_cache=cache,
        loader=jinja2.FileSystemLoader(HERE / "templates"), undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
        autoescape=jinja2.select_autoescape(enabled_extensions=("html.j2",), default=False))
    made.filters |= {"number": number, "sentence": sentence, "ending": ending, "shade": shade, "anchor": anchor,
                     "span": span, "visible_error": visible_error, "spoken": spoken,
                     "share_words": share_words, "advice": advice, "within": within, "assumptions": assumptions,
                     "sortable": plain_number, "counted": overview.counted, "worst": worst,
                     "query": urllib.parse.quote, "slug": slug}
    made.globals |= {"OUTCOMES": OUTCOMES, "LEVELS": tuple(LEVELS), "QUANTITIES": tuple(QUANTITIES),
                     "UNITS": QUANTITIES, "scene_file": scene_file, "engine_file": engine_file,
                     "study_file": study_file, "FORCE_UNITS": FORCE_UNITS, "LISTED": LISTED, "for_scripts": for_scripts,
                     "zip": zip, "WIDE": overview.WIDE, "HIGH": overview.HIGH}
    return made


def studies(document: Document) -> dict[str, str]:
    """Key and title of the studies that this document has data for."""
    records = document.records
    made = {"convergence": any(record.order for record in records),
            "speed": any(record.timing for record in records),
            "conservation": any(record.levels for record in records)}
    return {key: title for key, title in STUDIES.items() if made[key]}


@functools.cache
def _markdown() -> Any:
    """The same for Markdown: texts of engines and scenes must not become HTML, code, table columns or new lines."""
    return environment().overlay(finalize=lambda value: re.sub(r"[<`|]", r"\\\g<0>", " ".join(value.split()))
                                 if isinstance(value, str) else value)


def _render(template: str, document: Document, here: str, **more: object) -> str:
    made = _markdown() if template.endswith(".md.j2") else environment()
    return str(made.get_template(template).render(
        document=document, meta=document.meta, scenes=document.scenes, engines=document.meta.engines,
        studies=studies(document), here=here, changes=document.changes,
        pages={scene.name: scene_file(scene) for scene in document.scenes if not scene.failure}, **more))


def index(document: Document) -> str:
    """The first page: verdicts, changes, worst findings, and runs to trust."""
    return _overview("index.html.j2", document)


def summary(document: Document) -> str:
    """The content of the first page as Markdown, for a terminal or a pull request."""
    return _overview("summary.md.j2", document)


def _overview(template: str, document: Document) -> str:
    records, wrong = document.records, overview.worst_first(document.records, document.changes)
    return _render(
        template, document, "index", matrix=overview.by_method(document), cells=overview.pairs(records),
        headline="; ".join([*document.answers, headline(document)]), worst=wrong,
        right=overview.first_rows(document), tolerances=tolerances(records),
        pictures=overview.pictures(document, wrong), advice=overview.recommended(document.scenes),
        advised={each.scene for each in document.advice or []}, advice_rows=msgspec.to_builtins(document.advice))


def scene(document: Document, described: Scene) -> str:
    """The page of one scene."""
    records = [record for record in document.records if record.scene == described.name]
    # The reasons of bounds are numbered, because many findings share one.
    reasons = dict.fromkeys(finding.why for record in records for finding in record.findings if finding.why)
    sensors = {name: error.unit for record in records for name, error in record.errors.items()
               if name not in QUANTITIES}
    return _render("scene.html.j2", document, described.name, scene=described, records=records, sensors=sensors,
                   answers=answers(records, document.meta.need),
                   reasons={why: count for count, why in enumerate(reasons, 1)},
                   data_file=data_file(described))


def engine(document: Document, name: str) -> str:
    """The page of one engine: its runs and its known defects."""
    records = [record for record in document.records if record.engine == name]
    titles = {each.name: each.title for each in document.scenes}
    return _render("engine.html.j2", document, f"engine {name}", name=name, records=records, titles=titles,
                   worst=overview.worst_first(records))


def study(document: Document, key: str) -> str:
    """The page of one study over all scenes."""
    titles = {each.name: each.title for each in document.scenes}
    return _render(f"study-{key}.html.j2", document, f"study {key}", records=document.records,
                   titles=titles, title=STUDIES[key])
