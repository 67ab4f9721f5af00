"""`crosscheck list`: scenes, engines, methods."""

from __future__ import annotations

from crosscheck.cli.console import console
from crosscheck.cli.options import EngineNames
from crosscheck.cli.tables import figures, key, print_table, words
from crosscheck.errors import PINNED, install


def list_(engine: EngineNames = None) -> None:
    """List the engines with their versions and methods, and the scenes."""
    from crosscheck import adapters
    from crosscheck.running.provenance import NOT_INSTALLED, engine_version
    from crosscheck.scene.file import load_scene, scene_names

    terminal = console(160)
    rows = []
    for name in engine or (*adapters.names(), *(name for name in PINNED if name not in adapters.names())):
        try:
            version = engine_version(name)
            absent = version == NOT_INSTALLED and name in PINNED
            rows.append((name, version, install(name) if absent else " ".join(adapters.methods(name))))
        except ImportError:  # the adapter itself cannot be imported
            rows.append((name, NOT_INSTALLED, ""))
    print_table(terminal, [key("engine"), *figures("version"), words("methods")], rows)
    terminal.print()
    loaded = [load_scene(name) for name in scene_names()]
    print_table(terminal, [key("scene"), *figures("bodies", "duration"), words("what it is")],
                [(scene.name, str(scene.n), f"{scene.duration:g} s", scene.description) for scene in loaded])
