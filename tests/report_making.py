"""A small report of real runs, made in this process, for the tests of the report and its pages."""

import dataclasses

from crosscheck.judge.plan import Profile
from crosscheck.running import provenance
from crosscheck.verification import job, trust
from crosscheck.verification.cell import Cell, prepare_truth, run_cell

# Methods of first order take too small steps on the spring for a test.
RUNS = {"double_pendulum": (("lieeuler", "DAE3L_LE"), ("lieeuler", "DAE1L_LSE"), ("lieeuler", "rattle4"),
                            ("mujoco", "Euler"), ("mujoco", "RK4"), ("pinocchio", "RK4naive"), ("pinocchio", "RKMK4")),
        "spring_pendulum": (("lieeuler", "rattle4"), ("mujoco", "RK4"))}
CHANGES = [{"kind": "accuracy", "scene": "double_pendulum", "engine": "mujoco", "method": "RK4", "quantity": "position",
            "before": 1.0e-9, "after": 3.0e-6, "text": "the largest error grew beyond rounding", "bad": True},
           {"kind": "version", "scene": "", "engine": "mujoco", "method": "", "quantity": "", "before": "3.3.7",
            "after": "4.0.0", "text": "another version of the engine", "bad": False}]
SUPPORT = [{"scene": "double_pendulum", "engine": "mujoco", "form": "tree", "reason": None},
           {"scene": "double_pendulum", "engine": "exudyn", "form": "pivot", "reason": "one body at a pivot only"}]


def small_results():
    """`verify.Results` of the first seconds of two scenes."""
    described, records = [], []
    for name, runs in RUNS.items():
        scene = prepare_truth((name, False, Profile.most_steps))
        plan = scene.pop("plan")
        own = [run_cell(Cell(name, engine, method, None, plan, rungs=3, whole=False)) for engine, method in runs]
        for record in own:
            record.label = f"{record.engine} {record.method}"
        scene |= {"plan": dataclasses.asdict(plan), "recommended": trust.recommend(scene, own),
                  "trust": trust.sentence(scene, own)}
        described.append(scene)
        records += own
    meta = provenance.describe(list(dict.fromkeys(record.engine for record in records)))
    meta |= {"profile": "smoke", "jobs": 1, "command": "crosscheck verify --profile smoke --jobs 1", "seconds": 1.0}
    return job.Results(meta, described, records)
