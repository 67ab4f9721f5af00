"""Counts of the kernel without Python (tests/core/chain_driver.cpp) by callgrind: they do not depend on the load."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.model import Scene

__all__ = ["Run", "arguments", "build", "count", "missing_tool"]

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "tests" / "core" / "chain_driver.cpp"
HEADERS = ROOT / "lieeuler" / "_core"
CARRIERS = ("difference", "parent", "child")


@dataclasses.dataclass(frozen=True)
class Run:
    """A counted run: instructions, Newton iterations, and callgrind's file."""

    instructions: int
    iterations: int
    profile: Path


def missing_tool(*tools: str) -> str | None:
    """Why nothing can be counted here, or None."""
    absent = [tool for tool in tools if shutil.which(tool) is None]
    return f"{' and '.join(absent)} not installed" if absent else None


def build(folder: Path, *flags: str) -> Path:
    """The driver, compiled as the kernel is."""
    import cmeel  # its prefix holds the Eigen headers the kernel is built with

    program = folder / "driver"
    include = Path(cmeel.__file__).parents[1] / "cmeel.prefix" / "include" / "eigen3"
    subprocess.run(["c++", "-std=c++20", "-O3", "-fno-math-errno", "-w", *flags, "-I", str(include), "-I",
                    str(HEADERS), str(SOURCE), "-o",
                    str(program)], check=True)
    return program


def chain(n: int) -> Scene:
    """n pendulum bodies of 1 kg and 2 m on spherical joints, laid out in an arc and at rest."""
    base = crosscheck.load_scene("chain_8")
    body, pivot, link = base.bodies[0], base.joints[0], base.joints[1]
    half = np.array([0, 0, -1.0])
    bodies, joints, tip = [], [], np.zeros(3)
    for k in range(n):
        angle = 1.0 + 0.1 * k * min(1.0, 10.0 / n)
        arm = np.array([-np.sin(angle), 0.0, -np.cos(angle)])  # the half length turned about y
        attitude = np.array([np.cos(0.5 * angle), 0.0, np.sin(0.5 * angle), 0.0])
        bodies.append(dataclasses.replace(body, name=f"body {k}", position=tip + arm, attitude=attitude,
                                          velocity=np.zeros(3), angular_velocity=np.zeros(3)))
        tip = tip + 2 * arm
        joint = dataclasses.replace(link, parent=k - 1, child=k, parent_anchor=half) if k else pivot
        joints.append(dataclasses.replace(joint, name=f"joint {k}", child_anchor=-half))
    return base.replace(name=f"chain of {n}", bodies=tuple(bodies), joints=tuple(joints))


def problem(system: int | str) -> lieeuler.Problem:
    """A chain of so many bodies, or a scene by its name."""
    return build_problem(chain(int(system)) if str(system).isdecimal() else crosscheck.load_scene(str(system)))


def words(problem: lieeuler.Problem) -> list[float]:
    """A problem of plain joints, springs and loads, as the driver reads it."""
    ground, found = problem.n, [problem.n, *problem.gravity]
    for b, body in enumerate(problem.bodies):
        found += [body.mass, *body.inertia.flat, *problem.x[b], *problem.R[b].flat, *problem.v[b], *problem.w[b]]
    found.append(len(problem.joints))
    for joint in problem.joints:
        found += [joint.parent % (ground + 1), joint.child, *joint.parent_anchor, *joint.child_anchor,
                  int(joint.spherical), len(joint.dots)]
        for dot in joint.dots:
            found += [*(CARRIERS.index(each) for each in (dot.a, dot.b)), *dot.a_axis, *dot.b_axis, dot.constant,
                      dot.scale]
    found.append(len(problem.forces))
    for force in problem.forces:
        nothing = [0.0] * 3
        if isinstance(force, lieeuler.LinearSpring):
            found += [0, force.parent % (ground + 1), force.child, *force.parent_point, *force.child_point,
                      force.stiffness, force.free_length, force.damping, *nothing, *nothing]
        elif isinstance(force, lieeuler.ConstantLoad) and force.frame == "world" and force.factor is None:
            found += [2, ground, force.child, *nothing, *force.point, *nothing, *force.force, *force.torque]
        else:
            raise TypeError(f"the driver reads no {force}")
    return found


def arguments(folder: Path, method: str, system: int | str, steps: int, step: float) -> list[str]:
    """The driver's arguments; the system and a method's coefficients are written to `folder`."""
    record = lieeuler.METHODS[method]
    rule, file, given = record.tableau, folder / f"{method}.txt", folder / f"{system}.system"
    coefficients: list[float] = [len(record.composition), *record.composition]
    if rule is not None:
        coefficients = [rule.order]
        for rows in (rule.stages, (rule.weights,), rule.errors, rule.extra, rule.dense):
            coefficients.append(len(rows))
            for row in rows:
                coefficients += [len(row), *row]
    file.write_text(" ".join(map(repr, coefficients)))
    given.write_text(" ".join(repr(float(each)) for each in words(problem(system))))
    return [method, str(given), str(steps), str(step), str(file)]


def count(program: Path, method: str, system: int | str, steps: int, step: float, *options: str) -> Run:
    """Runs the driver under callgrind; `options` are callgrind's own."""
    profile = program.with_name("callgrind.out")
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}", *options,
               str(program), *arguments(program.parent, method, system, steps, step)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    total, iterations = re.search(r"Collected : (\d+)", run.stderr), re.search(r"iterations (\d+)", run.stdout)
    if total is None or iterations is None:
        raise RuntimeError(f"callgrind did not say what it counted: {run.stderr or run.stdout}")
    return Run(int(total[1]), int(iterations[1]), profile)
