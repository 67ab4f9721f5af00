"""Reference made when the site is built: commands, codes, engines, methods, scene files, results, speed."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]

STRUCT = re.compile(r'^class (\w+)\((\w+), frozen=True[^)]*\):\n    """(.*?)"""\n(.*?)(?=^\S|\Z)',
                    re.DOTALL | re.MULTILINE)
FIELD = re.compile(r"^    (\w+): ([^=#\n]+?)(?: = [^#\n]*?)?(?:  # (.*))?$", re.MULTILINE)
"""A type of the results with its base, docstring and body, and a field with its type and comment."""


def commands() -> str:
    """All commands with their options."""
    from typer.cli import get_docs_for_click
    from typer.main import get_command

    from crosscheck.cli.app import app

    command = get_command(app)
    context = command.make_context("crosscheck", ["list"], resilient_parsing=True)
    text = get_docs_for_click(obj=command, ctx=context, name="crosscheck")
    return text[text.index("\n## "):]


def verdicts() -> str:
    """Codes of verdicts."""
    from crosscheck.document.outcomes import KINDS

    kinds = "".join(row(each.code, each.title, each.mend) for each in KINDS.values())
    return f"\n| code | what | what to look at |\n|---|---|---|\n{kinds}"


def engines() -> str:
    """What the adapter of each engine declares, and the known defects of that engine."""
    from crosscheck.adapters.base import CHOICES, RunSpec
    from crosscheck.adapters.built_in import ENTRIES
    from crosscheck.adapters.common.known import table
    from crosscheck.scene.file import load_scene

    scene, text = load_scene("single_pendulum"), "\n## What engines declare\n"
    for name, entry in ENTRIES.items():
        engine = entry.make()
        orders = {each: engine.documented_order(scene, RunSpec(each, step=1e-3)) for each in engine.methods}
        methods = (f"`{each}`{'' if order is None else f' {order}'}" for each, order in orders.items())
        options = (f"{each} {' or '.join(CHOICES.get(each, ()))}" for each in sorted(engine.options - {"form"}))
        declared = {"version of its own environment": entry.version, "forms": ", ".join(engine.forms),
                    "methods, with the documented order on single_pendulum": ", ".join(methods),
                    "methods that take rtol": ", ".join(engine.adaptive_methods), "options": ", ".join(options),
                    "spacing of its numbers at 1": f"{engine.eps:.2g}",
                    "attitudes stay on SO(3)": "yes" if engine.on_group else "not declared",
                    "model files it reads": ", ".join(engine.reads)}
        known = "".join(row(", ".join(each.methods), ", ".join(each.versions),
                            ", ".join(each.scenes) or each.where or "all scenes",
                            ", ".join(f"{kind} {size:g}" for kind, size in each.rows.items()), each.reason,
                            each.evidence) for each in table() if each.engine == name)
        head = "| methods | versions | where | finding, size | reason | measured |\n|---|---|---|---|---|---|\n"
        about = importlib.import_module(entry.module).__doc__
        text += (f"\n### Engine {name}\n\n{about}\n\n| declared | |\n|---|---|\n"
                 + "".join(row(key, value) for key, value in declared.items() if value)
                 + (f"\nKnown defects:\n\n{head}{known}" if known else "\nNo known defects are listed.\n"))
    return text


def methods() -> str:
    """All methods of lieeuler."""
    import lieeuler

    rows = "".join(row(f"`{name}`", method.order or "follows rtol", ", ".join(method.held) or "none",
                       ", ".join(method.options()), method.source)
                   for name, method in lieeuler.METHODS.items())
    return f"\n| method | order | levels held to rounding | options | source |\n|---|---|---|---|---|\n{rows}"


def scene_files() -> str:
    """All tables of a scene file with their types and keys."""
    from crosscheck.scene import schema, sensors
    from crosscheck.scene.joints import JOINT_TYPES
    from crosscheck.scene.laws import SIZES

    files = [tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "scenarios").glob("*.toml"))]
    files.sort(key=lambda content: len(content["bodies"]), reverse=True)
    of_type = {entry["type"]: content["name"] for content in files
               for table in ("joints", "forces") for entry in content.get(table, ())}

    def since(table: str, name: str, of: dict[int, dict[str, tuple[str, ...]]]) -> int:
        return max((version for version, tables in of.items() if name in tables.get(table, ())), default=1)

    def keys(table: str, entry: type) -> str:
        rows = "".join(row(f"`{name}`", since(table, name, schema.KEYS), schema.expected(table, name))
                       for name in entry.__struct_fields__)
        return f"\n{' '.join((entry.__doc__ or '').split())}\n\n| key | version | value |\n|---|---|---|\n{rows}"

    joints = "".join(row(f"`{name}`", since("joints", name, schema.TYPES), ", ".join(kind.motion) or "nothing",
                         ", ".join(kind.coordinates), ", ".join(key for key, needed in kind.needs.items() if needed),
                         of_type.get(name, "")) for name, kind in JOINT_TYPES.items())
    text = ("\n## Types of joints\n\n| type | version | free motions | coordinates | keys it needs | scene |\n"
            f"|---|---|---|---|---|---|\n{joints}\n## Tables and keys\n")
    for table, entry in {"": schema.SceneEntry, **schema.ENTRIES}.items():
        text += f"\n### {table or 'the file itself'}\n{keys(table, entry)}"
    for table, types in {"forces": schema.FORCE_ENTRIES, "monitors": schema.MONITOR_ENTRIES}.items():
        text += f"\n### {table}\n" + "".join(
            f"\n**`{name}`** (version {since(table, name, schema.TYPES)}"
            f"{', scene ' + of_type[name] if name in of_type else ''}): {keys(table, entry)}"
            for name, entry in types.items())
    shapes = "".join(row(f"`{name}`", ", ".join(numbers) or "none") for name, numbers in SIZES.items())
    read = "".join(row(f"`{name}`", " and ".join(kind.needs), kind.unit, kind.axes)
                   for name, kind in sensors.SENSOR_TYPES.items())
    return (f"{text}\n## Types of shapes\n\n| type | size (m) |\n|---|---|\n{shapes}\n## Types of sensors\n\n"
            f"| type | reads at | unit (of a slide m, N) | frame, unless given |\n|---|---|---|---|\n{read}")


def declarations() -> str:
    """What a class of an engine may declare and read: attributes with their comments, methods with their docstrings."""
    from crosscheck.adapters.base import Engine, RunSpec
    from crosscheck.scene import model, schema

    def attributes(kind: type) -> str:
        found = FIELD.findall(inspect.getsource(kind))
        return "".join(row(f"`{name}`", f"`{typed}`", comment) for name, typed, comment in found)

    ends = ("type", "name", "parent", "child", "joint")
    forces = "".join(row(f"`{name}`", " and ".join(key for key in ends[2:] if key in entry.__struct_fields__),
                         "; ".join(f"`{key}`: {schema.expected('forces', key)}" for key in entry.__struct_fields__
                                   if key not in ends)) for name, entry in schema.FORCE_ENTRIES.items())
    methods = "".join(row(f"`{name}({', '.join([*inspect.signature(member).parameters][1:])})`",
                          " ".join((inspect.getdoc(member) or "").split()))
                      for name, member in vars(Engine).items() if inspect.isfunction(member))
    return (f"\n| attribute | type | what |\n|---|---|---|\n{attributes(Engine)}"
            f"\n| method | what |\n|---|---|\n{methods}"
            f"\n`RunSpec`, of which an engine reads `method`, `step` or `rtol`, and what it lists in `options`:\n\n"
            f"| field | type | what |\n|---|---|---|\n{attributes(RunSpec)}" + "".join(
                f"\n`{kind.__name__}`: {' '.join((kind.__doc__ or '').split())}\n\n| field | type | what |\n"
                f"|---|---|---|\n{attributes(kind)}" for kind in (model.Scene, model.Body, model.Joint, model.Force))
            + f"\n| type of force | acts at | its `parameters` |\n|---|---|---|\n{forces}")


def fields() -> str:
    """All types of results.json with their fields, and what the comments beside them say."""
    text = ""
    for file in ("part.py", "__init__.py"):
        source = (ROOT / "crosscheck" / "document" / file).read_text(encoding="utf-8")
        for name, base, said, body in STRUCT.findall(source):
            rows = "".join(row(f"`{key}`", f"`{kind}`", comment) for key, kind, comment in FIELD.findall(body))
            more = "" if base == "Part" else f" It has the keys of `{base}`, too."
            text += f"\n## {name}\n\n{' '.join(said.split())}{more}\n\n| key | type | what |\n|---|---|---|\n{rows}"
    return text


def speed() -> str:
    """The tables that `benchmarks.speed` has measured, and on what."""
    kept = json.loads((ROOT / "docs" / "static" / "speed.json").read_text(encoding="utf-8"))
    machine = kept["machine"]
    versions = ", ".join(f"{name} {each}" for name, each in {**kept["engines"], **kept["packages"]}.items() if each)
    text = (f"\nMade by `{kept['command']}` on {kept['time']}: {machine['processor']}, {machine['cores']} cores, load "
            f"{kept['load']}, {machine['system']}, Python {kept['python']}; {versions}.\n")
    for each in kept["tables"]:
        rows = "".join(row(*cells) for cells in (each["columns"], ["---"] * len(each["columns"]), *each["rows"]))
        text += f"\n## {each['title']}\n\n{each['said']}\n\n{rows}"
    return text


def row(*cells: object) -> str:
    """A row of a table."""
    return "| " + " | ".join(str(cell).replace("|", r"\|") for cell in cells) + " |\n"
