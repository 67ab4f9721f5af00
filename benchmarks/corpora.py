"""The verdicts on the corpora of wrong and right engines and on stock engines, in pieces; counts, and what is not met.

    python -m benchmarks.corpora CORPUS FILE [--every K] [--from J] [--only TEXT]
    python -m benchmarks.corpora table FILE

Each cell is one JSON line of FILE, and a cell that is there is not run again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pathlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.external.own import completed
from crosscheck.document import Plan, Record, Way
from crosscheck.verification.cell import judge_run, run_cell
from crosscheck.verification.task import Cell

Case = tuple[str, Callable[[], Record]]


def in_cell(engine: Any, method: str, scene: str, plan: Plan) -> Callable[[], Record]:
    """An engine of the tests in one cell."""
    def judged() -> Record:
        with adapters.lent(completed(engine(), "corpora", "1")) as name:
            return run_cell(Cell(scene, Way(name, method), plan))
    return judged


def in_scene(made: Callable[[], Any], engine: Any, method: str, steps: dict[int, float], tolerance: float = 1e-9
             ) -> Callable[[], Record]:
    """An engine on a scene that no file holds, at the step of its order or at a tolerance."""
    def judged() -> Record:
        scene, own = made(), engine()
        with adapters.lent(own) as name:
            adaptive = method in own.adaptive_methods
            order = own.documented_order(scene, RunSpec(method, **(
                {"rtol": tolerance} if adaptive else {"step": 1e-3})))  # type: ignore[arg-type]
            step, rtol = (None, tolerance) if order is None else (steps[order], None)
            traj = crosscheck.run(scene, engine=name, method=method, step=step, rtol=rtol)
            run = Record(scene=scene.name, engine=name, version="1", method=method, form=traj.form, step=step,
                         rtol=rtol, documented_order=order)
            return judge_run(run, scene, traj, own.held_levels(scene, RunSpec(method, step=1e-3)))
    return judged


def strangers() -> Iterator[Case]:
    """Wrong engines of `tests.engines.strangers`."""
    from tests.judge.test_corpora import CASES, STEPS

    for wrong, method, scene in CASES:
        plan = Plan({1: STEPS[method]}, samples=101, duration=4.0)
        yield f"{wrong.kind}, {wrong.name}, {method}, {scene}", in_cell(wrong.make, method, scene, plan)


def mistakes() -> Iterator[Case]:
    """Wrong engines of `tests.engines.mistakes`."""
    from tests.engines.mistakes import MISTAKES
    from tests.judge.test_wrong_engines import PLAN

    for mistake in MISTAKES:
        for scene in mistake.scenes:
            for order in mistake.orders:
                def make(mistake: Any = mistake) -> Any:
                    return mistake.make(np.random.default_rng(150))
                yield f"{mistake.name}, {scene}, {order}", in_cell(make, f"RKMK{order}", scene, PLAN)


def laws() -> Iterator[Case]:
    """Engines that are wrong in a law of a joint."""
    from tests import law_engines
    from tests.judge.test_law_engines import FORGETFUL, ORDERS, scene
    from tests.law_mistakes import MISTAKES, Wrong

    for mistake in (*MISTAKES, *FORGETFUL):
        for method in mistake.methods:
            yield f"{mistake.what}, {method}", in_scene(
                lambda name=mistake.scene: scene(name), lambda mistake=mistake: Wrong(mistake), method, ORDERS)
    for what, name in law_engines.MISTAKES.items():
        yield what, in_scene(lambda name=name: scene(name), lambda what=what: law_engines.Impulses(what), "Plain",
                             ORDERS)


def right() -> Iterator[Case]:
    """Right engines of `tests.engines.right`."""
    from tests.engines.right import UNUSUAL
    from tests.judge.test_right_engines import CASES, SCENES, plan

    for name, engine, method in [*CASES, *((name, *unusual) for name in SCENES[:5] for unusual in UNUSUAL)]:
        yield f"{engine.__name__} {method}, {name}", lambda name=name, engine=engine, method=method: (
            in_cell(engine, method, name, plan(name))())


def right_laws() -> Iterator[Case]:
    """Right engines on scenes with laws of joints."""
    from tests import law_engines
    from tests.judge.test_law_engines import BETWEEN, ORDERS, OTHERS, RIGHT, scene

    named = [*(("lieeuler", *case) for case in RIGHT), *OTHERS,
             *(("lieeuler", name, method) for name in BETWEEN for method in ("DAE1L_LSE", "rattle2", "rkmk4"))]
    for engine, name, method in named:
        yield f"{engine} {method}, {name}", in_scene(
            lambda name=name: scene(name), lambda engine=engine: adapters.get(engine), method, ORDERS)
    for name in ("drop", "encoder", "turns", "carriage", "corner"):
        yield f"Impulses, {name}", in_scene(lambda name=name: scene(name), law_engines.Impulses, "Plain", ORDERS)


def gate(classes: tuple[Any, ...]) -> Iterator[Case]:
    """Engines of `tests.gate` at the steps of its table, with enough outputs for segments."""
    from tests.gate import measure

    cases: Any = measure.CASES

    for cls in classes:
        name, size = cls.__name__, cases[cls.__name__][1]

        def made(name: str = name) -> Any:
            scene, _ = measure.case(name)
            return scene.replace(samples=max(scene.samples, 21))

        yield f"{name}, {cases[name][0]}", in_scene(
            made, lambda cls=cls: completed(cls(), "corpora", "1"), name, dict.fromkeys(range(1, 16), size), size)


def gate_right() -> Iterator[Case]:
    """Right engines of `tests.gate`."""
    from tests.gate.right import RIGHT

    return gate(RIGHT)


def gate_wrong() -> Iterator[Case]:
    """Wrong engines of `tests.gate`."""
    from tests.gate.wrong import WRONG

    return gate(WRONG)


def stock() -> Iterator[Case]:
    """Every method of every engine that is installed here, on all scenes, at the steps of the default plan."""
    from crosscheck.scene.file import scene_names
    from crosscheck.verification.plan import PROFILES
    from crosscheck.verification.scene_truth import prepare_truth
    from crosscheck.verification.task import cells_of

    profile = PROFILES["default"]
    for scene in scene_names():
        for engine in ("lieeuler", "mujoco", "pinocchio", "exudyn"):
            for cell in cells_of(scene, engine, PROFILES["smoke"]):
                def judged(cell: Cell = cell) -> Record:
                    known = prepare_truth((cell.scene, profile.most_seconds, profile.most_steps))
                    return run_cell(dataclasses.replace(cell, plan=known.plan, no_truth=known.no_truth))
                yield f"{scene}, {cell.label}", judged


CORPORA = {each.__name__: each for each in (strangers, mistakes, laws, right, right_laws, gate_right,
                                               gate_wrong, stock)}
WRONG = ("strangers", "mistakes", "laws", "gate_wrong")
"""Corpora that have to fail; all else has to pass."""


def row(judged: Callable[[], Record]) -> dict[str, Any]:
    """The verdict, with its processor time (s)."""
    begun = time.process_time()
    try:
        run = judged()
    except Exception as error:
        return {"outcome": "error", "why": f"{type(error).__name__}: {error}", "seconds": time.process_time() - begun}
    bad = [each for each in run.findings if each.status == "fail"]
    worst = max(bad, key=lambda each: each.severity, default=None)
    return {"outcome": run.outcome, "share": run.share, "cost": run.asked_steps, "seconds": time.process_time() - begun,
            "why": run.message or run.not_judged, "worst": None if worst is None else
            [worst.kind, worst.value, worst.bound, worst.detail[:600]]}


def collect(corpus: str, file: pathlib.Path, every: int, begin: int, only: str) -> None:
    """Runs the cells that the file does not have."""
    done = {json.loads(line)["case"] for line in file.read_text().splitlines()} if file.exists() else set()
    for k, (case, judged) in enumerate(CORPORA[corpus]()):
        if k % every != begin or case in done or only not in case:
            continue
        line = {"corpus": corpus, "case": case, **row(judged)}
        with file.open("a") as out:
            out.write(json.dumps(line) + "\n")
        print(case, "|", line["outcome"], f"{line.get('share') or 0.0:.2f}", f"{line['seconds']:.1f} s",
              line.get("worst") or line["why"], flush=True)


def table(file: pathlib.Path) -> None:
    """Counts, and the cells in which a corpus is not met."""
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    for (corpus, outcome), count in sorted(Counter((line["corpus"], line["outcome"]) for line in lines).items()):
        print(f"{corpus:12} {outcome:12} {count}")
    for what, unit in (("cost", "engine steps over the run's"), ("seconds", "s of processor time")):
        known = [line[what] for line in lines if line.get(what)]
        if known:
            print(f"{unit}: median {np.median(known):.3g}, 95 % below {np.quantile(known, 0.95):.3g}")
    for line in lines:
        wanted = "fail" if line["corpus"] in WRONG else "pass"
        if line["outcome"] != wanted:
            print(f"{line['corpus']:12} {line['case']}: {line['outcome']} ({100 * (line.get('share') or 0.0):.3g} %); "
                  f"{line.get('worst') or line['why']}")


def main() -> None:
    """Reads the arguments."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("corpus", choices=[*CORPORA, "table"])
    asked.add_argument("file", type=pathlib.Path)
    asked.add_argument("--every", type=int, default=1)
    asked.add_argument("--from", dest="begin", type=int, default=0)
    asked.add_argument("--only", default="")
    given = asked.parse_args()
    if given.corpus == "table":
        table(given.file)
    else:
        collect(given.corpus, given.file, given.every, given.begin, given.only)


if __name__ == "__main__":
    main()
