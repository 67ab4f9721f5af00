"""What the engines make of scenes before any stepping: `crosscheck list` and `inspect`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.console import console, figures, key, print_table, progress_bar, say, words
from crosscheck.cli.options import FORM, EngineNames, SceneName, among
from crosscheck.errors import PINNED, ArgumentError, Unsupported, counted, install

if TYPE_CHECKING:
    from crosscheck.inspection import Deviation, Inspection
    from crosscheck.running.support import Support


def list_(
    engine: EngineNames = None,
    support: Annotated[bool, typer.Option("--support", help="instead, the joints, forces and systems that each engine "
                                          "can model, in which form")] = False,
    reasons: Annotated[bool, typer.Option(help="with --support: why not the others")] = True,
) -> None:
    """List the engines with their versions and methods, and the scenes."""
    if support:
        _print_support(engine, reasons)
        return
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


def _print_support(engine: list[str] | None, reasons: bool) -> None:
    from crosscheck import adapters
    from crosscheck.running.support import matrix

    entries = matrix(engine or None)
    columns = list(dict.fromkeys((entry.engine, entry.form) for entry in entries))
    cells = {(entry.engine, entry.form, entry.kind, entry.item): entry for entry in entries}
    notes: dict[tuple[str, str], int] = {}  # footnote numbers, by engine with form and reason
    for entry in entries:
        if entry.reason is not None:
            notes.setdefault(_note(entry), len(notes) + 1)
    rows, last = [], ""
    for kind, item in dict.fromkeys((entry.kind, entry.item) for entry in entries):
        if kind != last:
            rows.append((f"{kind}:", *("" for _ in columns)))
        row = [cells[name, form, kind, item] for name, form in columns]
        rows.append((f"  {item}", *(_cell(entry, len(adapters.methods(entry.engine)), notes if reasons else {})
                                   for entry in row)))
        last = kind
    terminal = console(160)
    print_table(terminal, [key(""), *figures(*(f"{name} {form or ''}".strip() for name, form in columns))], rows)
    terminal.print("yes: by all methods; a/b: by a of b methods; -: not at all" + ("; [n]: why not" if reasons else ""),
                   markup=False)
    if reasons:
        for (label, reason), number in notes.items():
            terminal.print(f"[{number}] {label}: {reason}", markup=False)


def _note(entry: Support) -> tuple[str, str]:
    label = f"{entry.engine} {entry.form or ''}".strip()
    return label, (entry.reason or "").replace(f"type {entry.item}", "this type")


def _cell(entry: Support, methods: int, notes: dict[tuple[str, str], int]) -> str:
    number = notes.get(_note(entry))
    note = "" if number is None else f" [{number}]"
    if not entry.methods:
        return f"-{note}"
    return f"yes{note}" if len(entry.methods) == methods else f"{len(entry.methods)}/{methods}{note}"


def inspect(
    scene: SceneName,
    other: Annotated[str | None, typer.Argument(help="another model or scene: print what differs, whatever the names, "
                                                "order and format")] = None,
    engine: Annotated[list[str] | None, typer.Option("--engine", help="a name; may be repeated; default: all")] = None,
    form: Annotated[str | None, typer.Option(callback=among("--form", "tree", "maximal", "pivot"), help=(
        FORM + "every form"))] = None,
    states: Annotated[int, typer.Option(help="random admissible states beside the start", min=0, max=1000)] = 3,
    seed: Annotated[int, typer.Option(help="of the random states", min=0)] = 0,
    torques: Annotated[bool, typer.Option("--torques", help="only what drives have to supply, by inverse dynamics "
                                                            "of truth and engines: at the start for constant rates, "
                                                            "and compared at random states")] = False,
) -> None:
    """Compare models without integrating: of all engines for a scene or file, or two files with each other.

    Of a scene: masses, energies, mass matrix, forces and accelerations, against truth.

    A model file, .xml or .urdf, is loaded by every engine itself, and what an engine reads differently is named.

    Exit code 0: all agree with truth, or the two are the same motion; 1: one does not; 2: the check itself failed.
    """
    from crosscheck.inspection import inspect as examine
    from crosscheck.inspection.diff import diff
    from crosscheck.inspection.native import inspect as examine_natively
    from crosscheck.inspection.native import printed
    from crosscheck.scene.file import load_scene
    from crosscheck.scene.models import is_model

    if torques:
        raise typer.Exit(_torques(scene, engine, states, seed))
    if other is not None:
        report = diff(scene, other)
        for line in report.lines:
            say(line)
        raise typer.Exit(0 if report.same else 1)
    if is_model(scene):
        with progress_bar(f"every engine reads {scene}"):
            native = examine_natively(scene, engine or None, states, seed)
        printed(native, say)
        if rows := native.laws:
            columns = (*(["file"] if native.said else []), *(each.engine for each in native.native))
            print_table(console(200), [key("what differs"), *map(words, columns)], rows)
            say("-: it has no such number, or was not asked; in N m, N, rad, m and their rates; sizes and centre of "
                "shapes in m")
        if native.absent:
            print_table(console(200), [key("reads such files, not installed"), words("what installs it")],
                        [list(each) for each in native.absent.items()])
        raise typer.Exit(0 if native.agree else 1)
    with progress_bar(f"every engine's model of {scene}"):
        result = examine(load_scene(scene), engine or None, form, states, seed)
    _print_inspection(result)
    if not result.probes:
        raise ArgumentError(f"{scene}: none of the engines asked for can be inspected on this scene")
    raise typer.Exit(0 if result.agree else 1)


def _torques(name: str, engines: list[str] | None, states: int, seed: int) -> int:
    """Print generalized forces of the start, coordinate by coordinate, and compare the sources there and at random
    states; 1 if one is off by more than 1e-10 of the largest."""
    import numpy as np

    from crosscheck.jointspace.inverse import ENGINES, inverse_dynamics
    from crosscheck.jointspace.motion import JointSpace, positions
    from crosscheck.scene.file import load_scene
    from crosscheck.scene.models import import_model, is_model

    scene = import_model(name, drop=True, limits="drop", contacts="drop") if is_model(name) else load_scene(name)
    try:
        start = positions(scene), JointSpace(scene).speeds
    except Unsupported as error:
        raise Unsupported(f"{error}; then drives give the same motion by several sets of forces, or have to follow one "
                          "that is given") from None
    rng = np.random.default_rng(seed)
    q, v, a = (np.concatenate([[part], part + each]) for part, each in zip(
        (*start, 0.0 * start[1]), rng.uniform(-1.0, 1.0, (3, states, len(start[1]))), strict=True))
    by_source = {"truth": inverse_dynamics(scene, q, v, a)}
    skipped = {}
    for engine in engines or [each for each in ENGINES if each != "truth"]:
        try:
            by_source[engine] = inverse_dynamics(scene, q, v, a, engine)
        except Unsupported as error:
            skipped[engine] = str(error)
    say(f"{scene.name}: what drives supply at the start for constant rates (N m, N)")
    for k, coordinate in enumerate(scene.coordinates):
        readings = (f"{source} {values[0, k]:.12g}" for source, values in by_source.items())
        say(f"{coordinate}: {', '.join(readings)}", indent=2)
    gaps = {source: float(abs(values - by_source["truth"]).max(initial=0.0)) for source, values in by_source.items()}
    wrong = {source: gap for source, gap in gaps.items() if gap > 1e-10 * max(1.0, abs(by_source["truth"]).max())}
    say(f"the start and {counted(states, 'random state')}, with accelerations: sources differ from truth by at most "
        f"{max(gaps.values()):.1e}")
    for source, gap in wrong.items():
        say(f"✗ {source} differs from truth by {gap:.2g}")
    for source, reason in skipped.items():
        say(f"{source} is left out: {reason}")
    return int(bool(wrong))


def _print_inspection(result: Inspection) -> None:
    from crosscheck.inspection.base import QUANTITIES

    terminal = console(200)
    truth, scene = result.truth, result.scene
    assert truth.masses is not None
    assert truth.x is not None
    assert truth.kinetic is not None
    assert truth.potential is not None
    centre = truth.masses @ truth.x[0] / truth.masses.sum()
    terminal.print(
        f"{scene.name}: {counted(scene.n, 'body', 'bodies')}, {truth.masses.sum():.6g} kg, centre of mass at t = 0 "
        f"({', '.join(f'{value:.6g}' for value in centre)}) m, kinetic energy {truth.kinetic[0]:.6g} J, potential "
        f"{truth.potential[0]:.6g} J; compared at the start and {counted(len(result.states.t) - 1, 'random state')}")
    by_cell = {(d.engine, d.form, d.quantity): d for d in result.deviations}
    rows = {quantity: [by_cell.get((probe.engine, probe.form, quantity)) for probe in result.probes]
            for quantity in QUANTITIES}
    print_table(terminal, [key("largest relative deviation"), *figures(*(probe.label for probe in result.probes))],
                [[quantity, *map(_deviation, cells)] for quantity, cells in rows.items() if any(cells)])
    if result.probes:
        terminal.print("over the size of each quantity; -: not available from this model; !: beyond its bound")
    for probe in result.probes:
        for reason in dict.fromkeys(probe.notes.values()):
            missing = ", ".join(quantity for quantity, note in probe.notes.items() if note == reason)
            terminal.print(f"{probe.label}: not available: {missing}: {reason}", markup=False)
    for label, reason in result.skipped.items():
        terminal.print(f"{label} is left out: {reason}", markup=False)
    if result.offenders:
        terminal.print(f"first deviation beyond its bound: {result.offenders[0]}", markup=False, style="bold red")
    elif result.probes:
        terminal.print(f"all agree with truth: no deviation of {len(result.probes)} models is beyond its bound")
    for offender in result.offenders[1:]:
        terminal.print(f"  then: {offender}", markup=False)


def _deviation(deviation: Deviation | None) -> str:
    """A relative deviation, with a mark if it exceeds its bound."""
    if deviation is None:
        return "-"
    text = f"{deviation.relative:.1e}"
    return text if deviation.relative <= deviation.bound else f"{text} !"
