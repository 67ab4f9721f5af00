"""Documents of runs that nobody made, for the history to keep; figures that a test can choose."""

from __future__ import annotations

import dataclasses

from crosscheck.judge.verdict import Finding, Record
from crosscheck.verification.job import Results

SCALES = {"length": 1.0, "speed": 4.0, "rate": 5.0, "unit_rate": 3.0, "reach": 1.0, "kinetic": 10.0, "momentum": 8.0}
ROUNDING = dict.fromkeys(("position", "attitude", "velocity", "angular velocity", "energy", "momentum"),
                         (1e-12, 1e-14))


def record(scene="single_pendulum", engine="mujoco", method="RK4", *, error=1e-6, ratio=0.01, deviation=2e-4,
           outcome="pass", **more):
    """A record of a run that came to its end, with these figures."""
    made = Record(scene, engine, "4.0.0", method, "tree", 1e-3, None, 4, f"crosscheck run {scene}")
    made.label, made.outcome, made.status = f"{engine} {method}", outcome, "success"
    made.findings = [Finding("run", "ok", None, None, "", "a run has to reach its end")]
    made.errors = {"position": {"unit": "m", "end": error / 2, "max": error, "time": 1.0, "body": 0, "judged": error}}
    made.steps, made.wall_time, made.duration = 1000, 0.005, 10.0
    made.energy_error, made.orthogonality, made.us_per_step = error / 3, 1e-15, 500.0 * ratio
    made.speed = {"us_per_step": 500.0 * ratio, "us_deviation": 0.1, "ratio": ratio, "deviation": deviation,
                  "repeats": 9, "calibration": 500.0}
    made.orders = {"position": {"observed": 4.0, "documented": 4, "used": 4, "pairs": [], "note": ""}}
    made.ladder = [{"step": 1e-3, "steps": 1000, "errors": {"position": error}}]
    return dataclasses.replace(made, **more)


def document(records=None, *, started="2026-11-20T02:00:00+00:00", versions=None, exit_code=None, hashes=None):
    """The document of a run with these records."""
    records = [record()] if records is None else records
    engines = {each.engine: each.version for each in records} | (versions or {})
    names = list(dict.fromkeys(each.scene for each in records))
    meta = {"time": started[:16].replace("T", " ") + " UTC", "started": started, "engines": engines,
            "packages": {"numpy": "2.4.6"}, "python": "3.11.7", "commit": "0123456789ab", "profile": "full", "jobs": 2,
            "machine": {"system": "Linux x86_64", "processor": "some processor", "cores": 2},
            "command": "crosscheck nightly", "seconds": 60.0, "calibration": {"what": "loops", "us": 500.0}}
    scenes = [{"name": name, "hash": (hashes or {}).get(name, f"hash of {name}"), "scales": SCALES,
               "rounding": ROUNDING} for name in names]
    plain = Results(meta, scenes, records).plain()
    return plain if exit_code is None else plain | {"exit_code": exit_code}


def many(count, **more):
    """So many different records."""
    return [record(method=f"Method{number}", error=1e-6 * (1 + number), **more) for number in range(count)]
