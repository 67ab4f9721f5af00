"""One page of every kind beside a report, from made-up figures: studies, a sweep, the history, a trend."""

import itertools

import msgspec
import numpy as np
import pandas as pd  # noqa: TID253 - a test module

from crosscheck.document import Origin
from crosscheck.files import plain
from crosscheck.history.overview import write_history, write_trend
from crosscheck.history.runs import open_store, run_from_document, save, series
from crosscheck.report.standalone import page_of
from crosscheck.running import provenance
from crosscheck.studies.drift import Drift, DriftAsk, DriftStudy
from crosscheck.studies.stability import Line, Stability, StabilityAsk
from crosscheck.studies.study import StudyMeta, write_folder
from crosscheck.studies.work_precision import (
    Known,
    Rung,
    SceneLadders,
    WorkPrecision,
    WorkPrecisionAsk,
    curves,
    frontier,
)
from crosscheck.sweeps import summary
from tests.history.store.documents import document as night
from tests.history.store.documents import record

PAGES = ("work-precision/index.html", "stability/index.html", "drift/index.html", "sweep/index.html",
         "history/index.html", "history/trend.html")

SCENES = ("single_pendulum", "fast_top_1500", "sleeping_top_below")
WAYS = (("lieeuler", "DAE1H_LSE"), ("lieeuler", "rkmk853"), ("mujoco", "implicitfast"), ("pinocchio", "RKMK8"),
        ("exudyn", "GeneralizedAlpha"))


def meta(**more):
    """Where the figures come from: this machine."""
    known = provenance.describe(["lieeuler", "mujoco", "pinocchio", "exudyn"])
    return msgspec.convert(known | {"command": "crosscheck study", "seconds": 1.0, "time_limit": 1.0} | more, StudyMeta)


def stability(out):
    """A method with a step and one with a tolerance, a failure of every kind."""
    ways = [(*each, size) for each in itertools.product(SCENES, WAYS) for size in ("step", "rtol")]
    lines = [Line(engine, method, scene=scene, error=0.09, milliseconds=1.5, breaks_at=0.6 / (1 + index) ** 2,
                  reason="an error of 0.42 m", **{size: 0.3 / (1 + index) ** 2})
             for index, (scene, (engine, method), size) in enumerate(ways)]
    lines[4] = Line("mujoco", "", scene=SCENES[0], reason="no such joint")
    lines[7] = Line(*WAYS[3], scene=SCENES[0], breaks_at=1e-3, reason="the run diverged " * 8)
    write_folder(out, Stability().document(StabilityAsk(), meta(), lines), lines)


def work_precision(out):
    """Five ladders and a run that failed, on two scenes; a third has no truth."""
    scenes = []
    for scene in SCENES[:2]:
        rungs = [Rung(engine, method, step, scene=scene, label=f"{engine} {method}", steps=int(1 / step),
                      end_position=(10 * step) ** order, end_attitude=step**order, max_position=(20 * step) ** order,
                      max_attitude=step**order, samples=3, wall_ms=1e-3 * order / step, repeats=5)
                 for (engine, method), order in zip(WAYS, (1, 8, 2, 8, 2), strict=True) for step in (1e-2, 3e-3, 1e-3)]
        rungs.append(Rung("mujoco", "Euler", 1e-2, scene=scene, label="mujoco Euler", status="failed",
                          reason="it left the page"))
        scenes.append(SceneLadders(
            name=scene, description="A scene", duration=1.0, rungs=rungs,
            truth=Known(source="Taylor series", disagreement=1e-14, amplification=3.0),
            frontier={"end position": frontier(curves(rungs))}))
    scenes.append(SceneLadders(name="lost", description="A scene", duration=1.0, failure="no truth", rungs=[],
                               frontier={}))
    study = WorkPrecision()
    document = study.document(WorkPrecisionAsk(), meta(packages={"heyoka": "7.3.0"}), scenes)
    write_folder(out, document, study.rows(document))


def drift(out):
    """Runs that end and one that fails."""
    each = [{"scene": scene, "engine": engine, "method": method, "form": None, "label": f"{engine} {method}",
             "step": 2.0**-8, "duration": 100.0} for scene, (engine, method) in itertools.product(SCENES, WAYS)]
    lost = {"status": "failed", "reason": "diverged"}
    runs = [Drift(**one, steps=25600, **(lost if index == 3 else {
        "wall_time": 0.3, "energy_band": 1e-6, "energy_slope": 1e-12, "energy_growth": 0.5, "energy_trend": 0.01,
        "energy_verdict": "without trend", "momentum_band": 1e-14, "momentum_verdict": "round-off",
        "constraint_position": 1e-15, "orthogonality": 1e-15})) for index, one in enumerate(each)]
    write_folder(out, DriftStudy().document(DriftAsk(), meta(), runs), runs)


def sweep(out):
    """Two methods, one parameter, a cell that failed."""
    rows = [{"cell": f"{index:04x}", "scene": "single_pendulum", "engine": engine, "method": method, "form": None,
             "step": 1e-2, "rtol": np.nan, "member": index, "bodies.pendulum.mass": 1.0 + index % 3,
             "status": "failed" if index == 5 else "success", "position_error": 1e-4 * (1 + index),
             **dict.fromkeys(summary.FIGURES[1:], 1e-4)} for engine, method in WAYS[1:3] for index in range(9)]
    found = summary.document(pd.DataFrame(rows), ["bodies.pendulum.mass"], summary.Report(cells=18, workers=2),
                             msgspec.convert(provenance.describe(["lieeuler"]), Origin), "reports/sweep")
    page_of(out, "sweep.html.j2", document=plain(found), meta=plain(found)["meta"])


def history(out):
    """Eight nights of four runs, one of which becomes slower and then fails; and the page of that trend."""
    store = open_store(out.parent / "history.sqlite")
    for day in range(1, 9):
        started = f"2026-11-{day:02d}T02:00:00+00:00"
        records = [record(scene, "mujoco", method, ratio=0.01 if day < 5 else 0.013,
                          outcome="fail" if (method, day) == ("Euler", 8) else
                          "unresolved" if scene[0] == "d" else "pass",
                          error=10.0 ** -day) for scene in ("single_pendulum", "double_pendulum")
                   for method in ("RK4", "Euler")]
        save(store, run_from_document(f"{started[:10]}T02-00-00Z-00ff", night(records, started=started)))
    write_history(out, store)
    found = series(store, "speed ratio", ("single_pendulum", "mujoco", "RK4", ""))
    write_trend(out / "trend.html", found, "single_pendulum", "mujoco", "mujoco RK4")
    store.dispose()


def write_all(home):
    """Every page of `PAGES` into this folder."""
    for name in ("stability", "work-precision", "drift", "sweep"):
        (home / name).mkdir()
    stability(home / "stability")
    work_precision(home / "work-precision")
    drift(home / "drift")
    sweep(home / "sweep")
    history(home / "history")
