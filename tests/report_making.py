"""A small report of real runs, made in this process, for the tests of the report and its pages."""

import msgspec
from msgspec.structs import replace

from crosscheck.document import Advice, Change, Machine, Meta, Scene, Speed, Way
from crosscheck.running import provenance
from crosscheck.verification import job
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell

# Methods of first order take too small steps on the spring for a test.
RUNS = {"double_pendulum": (("lieeuler", "DAE3L_LE"), ("lieeuler", "DAE1L_LSE"), ("lieeuler", "rattle4"),
                            ("mujoco", "Euler"), ("mujoco", "RK4"), ("pinocchio", "RK4naive"), ("pinocchio", "RKMK4")),
        "spring_pendulum": (("lieeuler", "rattle4"), ("mujoco", "RK4"))}
CHANGES = [Change(kind="accuracy", scene="double_pendulum", engine="mujoco", method="RK4", quantity="position",
                  before=1.0e-9, after=3.0e-6, text="the largest error grew beyond rounding", bad=True),
           Change(kind="version", scene="", engine="mujoco", method="", quantity="", before="3.3.7", after="4.0.0",
                  text="another version of the engine")]
ADVICE = [
    Advice(scene=scene, engine=engine, wanted=10.0**-power, until=1.0, least=1e-12, method=method, form="tree",
           step=0.1 * 10 ** (-power / 4), error=0.7 * 10.0**-power, cost=1e-4 * 10 ** (power / 4), breaks_at=0.5,
           command=f"crosscheck run {scene} --engine {engine} --method {method} --step 0.1")
    for scene in RUNS for engine, method in (("lieeuler", "rattle4"), ("mujoco", "RK4")) for power in range(2, 9)
] + [Advice(scene="double_pendulum", engine="pinocchio", wanted=10.0**-power, until=1.0, least=2e-2,
             tried="within the budget of 30 s; finest step tried 0.001 s")
     for power in range(2, 9)]
SPEED = Speed(us_per_step=10.0, us_deviation=0.1, ratio=0.01, deviation=1e-4, repeats=3, calibration=1e3)  # made up


def document(truths, judged, engines, profile="default", need=1.0):
    """The document of these verdicts."""
    meta = provenance.describe(engines) | {"profile": profile, "jobs": 1, "seconds": 1.0, "need": need,
                                           "command": f"crosscheck verify --profile {profile}"}
    records = [replace(each, label=label) for each, label in zip(judged, job.labels(judged), strict=True)]
    return job.document(msgspec.convert(meta, Meta), truths, records)


def small_results():
    """The document of the first seconds of two scenes."""
    truths, judged = [], []
    for name, runs in RUNS.items():
        truths.append(prepare_truth((name, 1.0, Profile.most_steps)))
        judged += [replace(run_cell(Cell(name, Way(engine, method), truths[-1].plan)), speed=SPEED)
                   for engine, method in runs]
    return document(truths, judged, list(dict.fromkeys(each.engine for each in judged)), "smoke")


def failed_scene(name, failure):
    """A scene that could not be prepared."""
    return Scene(name=name, title=name, description="", source="", hash="", bodies=[], duration=0.0, plan=None,
                      truth=None, sizes=None, trust="", recommended=None, failure=failure)


def made(scenes, records):
    """A document of nothing but these."""
    meta = Meta(time="2026-11-21 02:00 UTC", engines={}, packages={}, python="3.11", commit=None, profile="default",
                machine=Machine(system="Linux", processor="some", cores=2), jobs=1, command="crosscheck verify",
                seconds=1.0)
    return job.document(meta, scenes, records)
