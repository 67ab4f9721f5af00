"""`crosscheck list`: scenes, engines, methods."""

from __future__ import annotations

from crosscheck.cli.console import console
from crosscheck.cli.options import EngineNames


def list_(engine: EngineNames = None) -> None:
    """The scenes, the engines with their versions, and their methods."""
    from rich.table import Table

    from crosscheck import adapters
    from crosscheck.running.provenance import NOT_INSTALLED, engine_version
    from crosscheck.scene.file import load_scene, scene_names

    scenes = Table("scene", "bodies", "duration", "what it is", box=None, title="scenes", title_justify="left")
    for name in scene_names():
        loaded = load_scene(name)
        scenes.add_row(name, str(loaded.n), f"{loaded.duration:g} s", loaded.description)
    table = Table("engine", "version", "methods", box=None, title="engines", title_justify="left")
    for name in engine or adapters.names():
        version = engine_version(name)
        methods = "" if version == NOT_INSTALLED and not _importable(name) else " ".join(adapters.methods(name))
        table.add_row(name, version, methods)
    terminal = console(160)
    terminal.print(scenes)
    terminal.print()
    terminal.print(table)


def _importable(engine: str) -> bool:
    from crosscheck import adapters

    try:
        adapters.get(engine)
    except ImportError:
        return False
    return True
