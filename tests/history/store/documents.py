"""Made-up documents of runs for the history, with figures that a test can choose."""

from __future__ import annotations

from msgspec.structs import replace

from crosscheck.document import (
    Calibration,
    Document,
    Errors,
    Finding,
    Machine,
    Meta,
    Order,
    Record,
    Rung,
    Scene,
    Speed,
    outcome_of,
)
from crosscheck.document.outcomes import EXIT_CODES

ROUNDING = dict.fromkeys(("position", "attitude", "velocity", "angular velocity", "energy", "momentum"),
                         (1e-12, 1e-14))


def record(scene="single_pendulum", engine="mujoco", method="RK4", *, error=1e-6, ratio=0.01, deviation=2e-4,
           outcome="pass", **more):
    """A record of a completed run with these figures."""
    made = Record(
        scene=scene, engine=engine, version="4.0.0", method=method, form="tree", step=1e-3, documented_order=4,
        command=f"crosscheck run {scene}", label=f"{engine} {method}", outcome=outcome, status="success",
        findings=[Finding("asked end", "ok", None, None, "", "a run has to reach its end")],
        errors={"position": Errors(unit="m", end=error / 2, max=error, time=1.0, body="rod", size=1.0)},
        steps=1000, wall_time=0.005, duration=10.0, energy_error=error / 3, orthogonality=1e-15,
        us_per_step=500.0 * ratio, ladder=[Rung(step=1e-3, rtol=None, errors={"position": error})],
        speed=Speed(us_per_step=500.0 * ratio, us_deviation=0.1, ratio=ratio, deviation=deviation, repeats=9,
                    calibration=500.0),
        order=Order(documented=4, observed=4.0, median=4.0, segments=8))
    return replace(made, **more)


def document(records=None, *, started="2026-11-20T02:00:00+00:00", versions=None, exit_code=None, hashes=None):
    """The document of a run with these records."""
    records = [record()] if records is None else records
    engines = {each.engine: each.version for each in records} | (versions or {})
    names = list(dict.fromkeys(each.scene for each in records))
    meta = Meta(
        time=started[:16].replace("T", " ") + " UTC", started=started, engines=engines, packages={"numpy": "2.4.6"},
        python="3.11.7", commit="0123456789ab", profile="full", jobs=2, command="crosscheck nightly", seconds=60.0,
        machine=Machine(system="Linux x86_64", processor="some processor", cores=2),
        calibration=Calibration(what="loops", us=500.0))
    scenes = [Scene(name=name, title=name, description="", source="", bodies=[], duration=10.0, plan=None, truth=None,
                    hash=(hashes or {}).get(name, f"hash of {name}"), sizes={"position": 1.0}, trust="",
                    rounding=ROUNDING, recommended=None) for name in names]
    outcome = outcome_of(scenes, records)
    found = EXIT_CODES[outcome] if exit_code is None else exit_code
    return Document(meta=meta, scenes=scenes, records=records, outcome=outcome, exit_code=found)


def many(count, **more):
    """`count` different records."""
    return [record(method=f"Method{number}", error=1e-6 * (1 + number), **more) for number in range(count)]
