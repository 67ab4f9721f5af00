"""How often `crosscheck explain` names the right cause: mis-built engines with random magnitudes on random scenes.

python -m benchmarks.explain_study --seeds 100..140                 one and two causes at once, a line each, then tables
python -m benchmarks.explain_study --counts 3                       three causes at once
python -m benchmarks.explain_study --mistakes 7                     every mistake of the tests' suite, by this seed
python -m benchmarks.explain_study --correct                        correct engines over all scenes: false alarms
--keep FILE appends every result to FILE (JSON lines) and skips the cases already in it; tables cover all of them.
"""

from __future__ import annotations

import argparse
import collections
import json
import time
from pathlib import Path

import numpy as np

from crosscheck import adapters
from crosscheck.diagnosis import explain
from crosscheck.diagnosis.observe import Silent, Subject, observe, scale_of, window
from crosscheck.diagnosis.of_stepping import pushed
from crosscheck.document import Way
from crosscheck.errors import EngineError, SceneError, Unsupported
from crosscheck.references import TruthError
from tests.diagnosis import misbuilt
from tests.diagnosis.mistakes import MISTAKES, scored, visible

MODEL = ("gravity size", "gravity sign", "gravity axis", "inertia point", "inertia frame", "mass", "missing body",
         "quaternion order", "quaternion conjugated", "velocity frame", "spring stiffness", "spring free length",
         "missing spring", "missing damper", "extra damping", "soft constraint")
STEPPING = ("stabilisation gain", "group update", "hidden sub-steps")
CAUSES = (*MODEL, *STEPPING)
ALONE = {"soft constraint": ("stabilisation gain", "hidden sub-steps"), "stabilisation gain": ("soft constraint",),
         "group update": ("hidden sub-steps",), "hidden sub-steps": ("group update",),
         "missing body": ("velocity frame", "mass")}
"""Causes that one engine cannot have at once, or that cannot be told apart in principle."""

SCORES = ("named", "equally", "unknown", "wrong", "acquitted")
"""Of the suite of the tests."""

EFFECT = 1e-8
"""Normalised: a magnitude that changes a coarse run by less does not count; `explain` calls that agreement."""

BASES = (None, ("mujoco", "RK4"), ("pinocchio", "RKMK4"), ("lieeuler", "rattle4"))
"""What alterations of the scene sit on; None is the stepper of the tests, which alone can have flaws of stepping."""


def drawn(seed: int, count: int):
    """(scene, cases, base) of a seed: `count` different causes that the scene can show."""
    rng = np.random.default_rng([seed, count])
    scene = misbuilt.random_scene(rng)
    first = CAUSES[seed % len(CAUSES)]
    names = [first, *rng.permutation([name for name in CAUSES if name != first])]
    cases: list[misbuilt.Case] = []
    for name in names:
        if len(cases) == count:
            break
        if any(name in ALONE.get(case.name, ()) or case.name in ALONE.get(name, ()) or _same(case.name, name)
               for case in cases):
            continue
        case = misbuilt.make(str(name), rng, scene)
        if case:
            cases.append(case)
    flawed = any(case.flaws for case in cases)
    choice = None if flawed else BASES[rng.integers(len(BASES))]
    if choice is not None and Subject(adapters.get(choice[0]), Way(*choice)).unsupported(scene):
        choice = None
    return scene, cases, choice


def _same(one: str, other: str) -> bool:
    """Whether two causes alter the same thing."""
    groups = (("gravity size", "gravity sign", "gravity axis"), ("quaternion order", "quaternion conjugated"),
              ("spring stiffness", "spring free length", "missing spring", "missing damper"))
    return any(one in group and other in group for group in groups)


def effect(scene, cases, case, base, method) -> float:
    """What one of the cases changes in a coarse run of the engine that has them all, normalised.

    A stabilisation gain is looked for in the limit, where the joints are violated; an engine that closes them itself
    shows none.
    """
    scale = scale_of(scene)
    brief = window(scene, scale)
    gain = case.name == "stabilisation gain"
    runs = []
    for kept in (cases, [other for other in cases if other is not case]):
        subject = Subject(misbuilt.build(kept, base), Way("misbuilt", method))
        try:
            runs.append(observe(subject, pushed(brief, scale), scale).y if gain else scale.flat(
                subject.run(brief, brief.duration / (brief.samples - 1)).states))
        except Silent:
            return 1.0
    return float(np.abs(runs[0] - runs[1]).max())


def one(seed: int, count: int) -> dict:
    """Draw, explain, score: "named", "unknown", "wrong", "no effect" or "refused"."""
    scene, cases, choice = drawn(seed, count)
    base = None if choice is None else adapters.get(choice[0])
    method = "RK4" if choice is None else choice[1]
    seen = {case.name for case in cases if effect(scene, cases, case, base, method) > EFFECT}
    result = {"seed": seed, "count": count, "causes": [[case.name, case.magnitude] for case in cases],
              "scene": [joint.type for joint in scene.joints], "engine": choice[0] if choice else "stepper"}
    began = time.perf_counter()
    try:
        answer = explain(scene, misbuilt.build(cases, base), method)
    except EngineError as error:
        return result | {"score": "refused", "sentence": str(error)}
    result |= {"sentence": answer.sentence, "seconds": time.perf_counter() - began, "names": answer.names,
               "deviation": answer.deviation}
    allowed = {case.name for case in cases}
    if answer.outcome == "unresolved":
        score = "unknown"
    elif not seen and answer.outcome == "pass":
        score = "no effect"
    else:
        score = "named" if seen <= set(answer.names) <= allowed and answer.names else "wrong"
    return result | {"score": score}


def table(results: list[dict]) -> str:
    """Counts per cause, for one cause and for more at once."""
    lines = []
    for count, title in ((1, "one cause"), (2, "two causes at once, counted under each"),
                         (3, "three causes at once, counted under each")):
        rows: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
        total: collections.Counter = collections.Counter()
        for result in results:
            if result["count"] == count:
                total[result["score"]] += 1
                for name, _ in result["causes"]:
                    rows[name][result["score"]] += 1
        lines.append(f"{title:40s} named unknown wrong  no effect refused")
        for name, found in [*((name, rows[name]) for name in CAUSES if name in rows), ("all", total)]:
            lines.append(f"{name:40s} {found['named']:5d} {found['unknown']:7d} {found['wrong']:5d} "
                         f"{found['no effect']:10d} {found['refused']:7d}")
    times = [result["seconds"] for result in results if "seconds" in result]
    lines.append(f"seconds of one explain: median {np.median(times):.1f}, largest {max(times):.1f}")
    return "\n".join(lines)


def mistakes(seed: int, keep: Path | None, most: float, scenes: list[str]) -> None:
    """Score the suite of tests/diagnosis/mistakes.py, a line each that is not named, then a table by mistake.

    On `scenes`, if given, in random order, instead of those of each mistake; on the first where it shows.
    """
    results, began = read(keep), time.perf_counter()
    done = {(result["mistake"], result["scene"], result["seed"]) for result in results}
    cases = [(mistake, name) for mistake in MISTAKES for name in scenes or mistake.scenes]
    for k in np.random.default_rng(seed).permutation(len(cases)) if scenes else range(len(cases)):
        mistake, name = cases[k]
        if (mistake.key, name, seed) in done or time.perf_counter() - began > most or (
                scenes and not visible(mistake, name, seed)):
            continue
        start = time.process_time()
        score, answer = scored(mistake, name, seed)
        result = {"mistake": mistake.key, "scene": name, "seed": seed, "score": score,
                  "sentence": answer.sentence, "seconds": time.process_time() - start}
        results.append(result)
        written(keep, result)
        if score != "named":
            print(f"{mistake.key:22s} {name:16s} {score}: {answer.sentence}", flush=True)
    rows = {mistake.key: collections.Counter(result["score"] for result in results
                                             if result["mistake"] == mistake.key) for mistake in MISTAKES}
    for key, row in [*rows.items(), ("all", collections.Counter(result["score"] for result in results))]:
        print(f"{key:24s} {row.total():5d} " + "  ".join(f"{score} {row[score]:4d}" for score in SCORES))
    times = [result["seconds"] for result in results]
    print(f"seconds of processor time of one explain: median {np.median(times):.1f}, largest {max(times):.1f}")


def read(keep: Path | None) -> list[dict]:
    """Results that were kept."""
    kept = keep.read_text(encoding="utf-8").splitlines() if keep and keep.exists() else []
    return [json.loads(line) for line in kept]


def written(keep: Path | None, result: dict) -> None:
    """Keep one more."""
    if keep:
        with keep.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")


def correct(keep: Path | None, scenes: list[str]) -> None:
    """Explain every engine's best method on every scene of up to eight bodies."""
    from crosscheck.scene.file import load_scene, scene_names

    for name in scenes or scene_names():
        for engine in adapters.names():
            if load_scene(name).n > 8:
                continue
            try:
                answer = explain(name, engine)
                text = f"{answer.outcome}: {answer.sentence}"
            except (Unsupported, EngineError, SceneError, TruthError) as error:
                text = f"not run: {error}"
            print(f"{name:24s} {engine:10s} {text[:200]}", flush=True)
            written(keep, {"scene": name, "engine": engine, "text": text})


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100..110")
    parser.add_argument("--counts", default="1,2")
    parser.add_argument("--correct", action="store_true")
    parser.add_argument("--mistakes", type=int, metavar="SEED", help="the suite of the tests, by this seed")
    parser.add_argument("--scenes", nargs="*", default=[], help="default: all; of --mistakes: those of each")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--most", type=float, default=float("inf"), help="stop after so many seconds")
    given = parser.parse_args()
    if given.correct:
        correct(given.keep, given.scenes)
        return
    if given.mistakes is not None:
        mistakes(given.mistakes, given.keep, given.most, given.scenes)
        return
    first, last = (int(part) for part in given.seeds.split(".."))
    results = read(given.keep)
    done, began = {(result["seed"], result["count"]) for result in results}, time.perf_counter()
    for seed in range(first, last):
        for count in (int(part) for part in given.counts.split(",")):
            if (seed, count) in done or time.perf_counter() - began > given.most:
                continue
            result = one(seed, count)
            results.append(result)
            print(json.dumps(result), flush=True)
            written(given.keep, result)
    print(table(results))


if __name__ == "__main__":
    main()
