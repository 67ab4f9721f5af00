"""A scene as a Python script that builds its model in Exudyn, solves it and prints the states.

The script records the calls by which `models.maximal` builds the model for crosscheck's own runs.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.exudyn import models, solving
from crosscheck.adapters.exudyn.adapter import Exudyn
from crosscheck.adapters.exudyn.items import Varied
from crosscheck.errors import SceneError, install
from crosscheck.files import cell
from crosscheck.scene.model import Scene

METHOD, STEP = "GeneralizedAlpha", 1e-3
"""Method and default step (s) of the script; the step is an argument of the script."""

SCRIPT = '''"""A scene as a model of Exudyn: a node for every body, a constraint for every joint.

    python THIS_FILE [STEP] > states.csv

SI units. Nodes are at the centres of mass, with axes along the world's at t = 0; R0 maps the body axes of the scene to
node axes. Columns: t, then x (world), R (rows, body to world), v (world), w (body axes) of every body.
Written by crosscheck convert with Exudyn {version}.
"""

import sys

import exudyn
import numpy as np
from exudyn.itemInterface import *

SCENE = {scene!r}
DURATION, SAMPLES = {duration!r}, {samples}
STEP = float(sys.argv[1]) if len(sys.argv) > 1 else {step!r}
PER = max(1, int(np.ceil(DURATION / (SAMPLES - 1) / STEP * (1 - 1e-9))))  # steps in one interval of the output
BODIES = {bodies!r}
R0 = np.array({R0})
OUTPUTS = ("Position", "RotationMatrix", "Velocity", "AngularVelocityLocal")

{varied}
def build():
    """(container, system, sensors of `OUTPUTS` for every body)."""
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
{calls}
    sensors = [[mbs.AddSensor(SensorBody(bodyNumber=body, storeInternal=True, writeToFile=False,
                                         outputVariableType=getattr(exudyn.OutputVariableType, output)))
                for output in OUTPUTS] for body in [{objects}]]
    mbs.Assemble()
    return container, mbs, sensors


def settings(tolerance):
    """Fixed steps; `tolerance` is Newton's."""
    made = exudyn.SimulationSettings()
    made.timeIntegration.endTime = DURATION
    made.timeIntegration.numberOfSteps = PER * (SAMPLES - 1)
    made.solution.sensors.writePeriod = DURATION / (SAMPLES - 1)
    made.timeIntegration.newton.absoluteTolerance = made.timeIntegration.newton.relativeTolerance = tolerance
{settings}
    return made


def solved():
    """The system and its sensors after the run, with the tightest tolerance that converges."""
    for tolerance in {tolerances!r}:
        container, mbs, sensors = build()
        try:
            if mbs.SolveDynamic(settings(tolerance), solverType=exudyn.DynamicSolverType.{method}):
                return container, mbs, sensors
        except exudyn.SolverError:  # no convergence
            pass
    sys.exit("Exudyn does not solve it; try a smaller step")


def main():
    """Solve and print."""
    exudyn.config.printToConsole = False
    container, mbs, sensors = solved()
    columns, header = [np.linspace(0, DURATION, SAMPLES)[:, None]], ["t"]
    for body, turn, mine in zip(BODIES, R0, sensors):
        x, R, v, w = (np.array(mbs.GetSensorStoredData(sensor))[:, 1:] for sensor in mine)
        columns += [x, (R.reshape(-1, 3, 3) @ turn).reshape(-1, 9), v, w @ turn]
        header += [f"{{body}} {{name}}" for name in [*(f"x_{{i}}" for i in "xyz"), *(
            f"R_{{i}}{{j}}" for i in "123" for j in "123"), *(f"{{key}}_{{i}}" for key in "vw" for i in "xyz")]]
    np.savetxt(sys.stdout, np.hstack(columns), "%.17g", ",", header=",".join(header), comments="")


if __name__ == "__main__":
    main()
'''

OF_THE_RUN = {f"made.{key}" for key in (
    "solution.sensors.writePeriod", *(f"timeIntegration.{key}" for key in (
        "endTime", "numberOfSteps", "newton.absoluteTolerance", "newton.relativeTolerance")))}
"""Settings that the script computes itself."""

VARIED = '''
def varied(breaks, pieces, terms):
    """A load times a function of time: polynomials in t - break, constant first, and amplitude sin(rate t + phase)."""
    def load(mbs, t, vector):
        k = max(0, int(np.searchsorted(breaks, t, side="right")) - 1)
        factor = np.polynomial.polynomial.polyval(t - breaks[k], pieces[k])
        return (np.array(vector) * (factor + sum(a * np.sin(rate * t + phase) for a, rate, phase in terms))).tolist()
    return load

'''


class _Name(int):
    """Exudyn's index of an item, with the name of the script's variable for it."""

    name: str


class _Recorder:
    """Takes the place of a main system and records added items as lines of a script."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.bodies: list[str] = []
        self.counts: dict[str, int] = {}

    def __getattr__(self, call: str) -> object:
        if not call.startswith("Add"):
            raise AttributeError(call)
        kind = call.removeprefix("Add").lower()

        def add(item: object) -> _Name:
            index = _Name(self.counts.get(kind, 0))
            index.name = f"{kind}{int(index)}"
            self.counts[kind] = index + 1
            arguments = []
            for key, parameter in inspect.signature(type(item)).parameters.items():
                text = _text(getattr(item, key, parameter.default))
                if key != "visualization" and text != _text(parameter.default):
                    arguments.append(f"{key}={text}")
            if kind != "sensor":  # the script adds its own sensors
                self.lines.append(f"{index.name} = mbs.{call}({type(item).__name__}({', '.join(arguments)}))")
            if type(item).__name__ == "ObjectRigidBody":
                self.bodies.append(index.name)
            return index

        return add


def _text(value: object) -> str:
    """A Python expression for the value."""
    import exudyn

    if isinstance(value, _Name):
        return value.name
    if isinstance(value, Varied):
        f = value.function
        return f"varied({f.breaks!r}, {f.pieces!r}, {f.terms!r})"
    if isinstance(value, exudyn.HT):
        return f"exudyn.HT(rotation={_text(value.rotation)}, translation={_text(value.translation)})"
    if type(value).__module__.startswith("exudyn"):  # an enumeration
        return f"exudyn.{value}"
    if isinstance(value, np.ndarray | list | tuple):
        return "[" + ", ".join(_text(each) for each in value) + "]"
    return repr(value.item() if isinstance(value, np.generic) else value)


def _changed(default: Mapping[str, Any], chosen: Mapping[str, Any], path: str) -> Iterator[str]:
    """Assignments that change Exudyn's default settings to `chosen`."""
    for key, value in chosen.items():
        if isinstance(value, dict):
            yield from _changed(default[key], value, f"{path}.{key}")
        elif value != default[key]:
            yield f"{path}.{key} = {_text(value)}"


def script(scene: Scene) -> str:
    """The text of the script; raises `SceneError`, which names what Exudyn cannot hold."""
    try:
        exudyn = solving.load()
    except ImportError as error:
        raise SceneError(f"{scene.name}: a script for Exudyn is written with Exudyn, which cannot be imported "
                         f"({error}); {install('exudyn')}") from None
    engine, spec = Exudyn(), RunSpec(METHOD, form="maximal")
    if (reason := engine.unsupported(scene, spec)) is not None:
        raise SceneError(f"{scene.name}: Exudyn cannot hold this scene: {reason}")
    recorder = _Recorder()
    models.maximal(scene, system=recorder)
    chosen = solving.settings(METHOD, 1.0, 1, 1, 1.0, engine.linear_solver(scene, spec, "maximal")).GetDictionary()
    settings = [line for line in _changed(exudyn.SimulationSettings().GetDictionary(), chosen, "made")
                if line.split(" = ")[0] not in OF_THE_RUN]

    def indented(code: list[str]) -> str:
        return "\n".join(f"    {line}" for line in code)

    return SCRIPT.format(
        version=engine.version(), scene=scene.name, duration=scene.duration, samples=scene.samples, step=STEP,
        bodies=[cell(body.name) for body in scene.bodies], R0=_text(scene.R0), varied=VARIED if scene.functions else "",
        calls=indented(recorder.lines), objects=", ".join(recorder.bodies), settings=indented(settings),
        tolerances=solving.NEWTON_TOLERANCES, method=METHOD)
