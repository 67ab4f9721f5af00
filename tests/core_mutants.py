"""Wrong equations in the kernel, and which of them its tests let live.

    python -m tests.core_mutants                 all
    python -m tests.core_mutants --only 3 17     these; numbers as they are printed

All are compiled into one kernel, in a copy of its sources; the environment says which one counts.
"""

from __future__ import annotations

import argparse
import functools
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests import ROOT

Vector, Matrix = "Vec3", "Mat3"
MUTANTS = (
    # file, what stands there once, what is put in its place, type
    ("model/joints.hpp", "point_rate(kChild, child) - point_rate(kParent, parent)",
     "point_rate(kChild, child) + point_rate(kParent, parent)", Vector),
    ("model/joints.hpp", "point_second(kChild, child.w) - point_second(kParent, parent.w)",
     "point_second(kChild, child.w)", Vector),
    ("model/joints.hpp", "transposed_times(frame_[kChild]->R, lam)", "times(frame_[kChild]->R, lam)", Vector),
    ("model/joints.hpp", "2 * u.first(A).dot(u.first(B))", "u.first(A).dot(u.first(B))", "double"),
    ("model/joints.hpp", "A.arm[side].cross(dB) + B.arm[side].cross(dA)", "A.arm[side].cross(dB)", Vector),
    ("model/joints.hpp", "s.dot(l)", "-s.dot(l)", "double"),
    ("model/joints.hpp", "turned(side, side == kChild ? s.cross(w) : w.cross(s))",
     "turned(side, side == kChild ? w.cross(s) : s.cross(w))", Matrix),
    ("model/joints.hpp", "2 * arm_a.dot(arm_b)", "arm_a.dot(arm_b)", "double"),
    ("model/joints.hpp", "ar * bc + br * ac", "ar * bc - br * ac", "double"),
    ("model/joints.hpp", "hat_product(w, s)", "hat_product(s, w)", Matrix),
    ("model/axis_rows.hpp", "row.own.cross(turn.cross(row.other)) + row.other.cross(row.own.cross(w))",
     "row.own.cross(turn.cross(row.other)) - row.other.cross(row.own.cross(w))", Vector),
    ("model/axis_rows.hpp", "pull.dot(row.own)", "0", "double"),
    ("model/axis_rows.hpp", "lam[r] * row.own.cross(turn.cross(row.other))",
     "lam[r] * row.own.cross(turn.cross(row.own))", Vector),
    ("model/forces.hpp", "force_.damping * rate_ - drive()", "force_.damping * rate_ + drive()", "double"),
    ("model/forces.hpp", "c * across * speed_", "Vec3::Zero()", Vector),
    ("model/forces.hpp", "tension() * slope", "-tension() * slope", Matrix),
    ("model/forces.hpp", "hat(transposed_times(R, force_.torque))", "Mat3::Zero()", Matrix),
    ("model/forces.hpp", "transposed_times(relative, force_.axis)", "times(relative, force_.axis)", Vector),
    ("model/contact.hpp", "radius * by_axis * hat(axis_)", "-radius * by_axis * hat(axis_)", Matrix),
    ("model/contact.hpp", "turned.dot(speed) + t.dot(bend)", "t.dot(bend)", "double"),
    ("model/so3.hpp", "quadratic(theta_, 1 - k_.cubic * s_, -k_.cosc, k_.cubic)",
     "quadratic(theta_, 1 - k_.cubic * s_, k_.cosc, k_.cubic)", Matrix),
    ("model/so3.hpp", "L + 0.5 * turned + c * theta_.cross(turned)", "L - 0.5 * turned + c * theta_.cross(turned)",
     Vector),
    ("model/so3.hpp", "X * turn - hat(turned)", "X * turn + hat(turned)", Matrix),
    ("model/so3.hpp", "0.25 * theta_.dot(L)", "0.5 * theta_.dot(L)", "double"),
    ("model/so3.hpp", "y.dot(e1.cross(third_axis))", "-y.dot(e1.cross(third_axis))", "double"),
    ("model/system.hpp", "(times(body.inertia_deviation, w) + body.spin).cross(w)",
     "times(body.inertia_deviation, w).cross(w)", Vector),
    ("model/mimic.hpp", "mimic.ratio * leader[0]", "leader[0]", "double"),
    ("model/time_function.hpp", "last_begun(at.from)", "last_begun(at.time + Moment::rounding(at.time))", "size_t"),
    ("model/plan.hpp", "next != jumps.end() && end.ends_at(*next)", "false", "bool"),
    ("methods/body_chart.hpp", "w + 0.5 * turned + k.inverse * theta.cross(turned)",
     "w - 0.5 * turned + k.inverse * theta.cross(turned)", Vector),
    ("methods/euler_lagrange.hpp", "times(body.inertia, gain.w) - force_time() * f.w",
     "times(body.inertia, gain.w) + force_time() * f.w", Vector),
    ("methods/unstabilised.hpp", "twice_alpha * rate", "0.5 * twice_alpha * rate", Vector),
    ("methods/unstabilised.hpp", "square * position(k)", "gains_.beta * position(k)", Vector),
    ("methods/euler_lagrange.hpp", "force_time() * gyroscopic_slope(w, angular_momentum(body, w), body.inertia)",
     "-force_time() * gyroscopic_slope(w, angular_momentum(body, w), body.inertia)", Matrix),
    ("methods/euler_lagrange.hpp", "force_time() * joints.gamma(part, state.u)[0]", "0", "double"),
    ("methods/unstabilised.hpp", "G + at.h * N * at.tangents[place.body]",
     "G - at.h * N * at.tangents[place.body]", Matrix),
    ("methods/euler_lagrange.hpp", "plain_ ? drift : momentum(system.bodies[b], drift)", "drift", "Twist"),
    ("methods/euler_hamilton.hpp", "momentum_[b] + impulse_time() * force[b]",
     "momentum_[b] - impulse_time() * force[b]", "Twist"),
    ("methods/rattle.hpp", "start_joints.velocity(plan.parts[k], xi)", "Vec3::Zero()", Vector),
    ("methods/euler_hamilton.hpp", "transposed_times(rotations[b], impulse_[b].w)",
     "times(rotations[b], impulse_[b].w)", Vector),
    ("methods/euler_hamilton.hpp", "h * hat(angular_momentum(body, state.u[b].w)) * tangents[b]",
     "Mat3::Zero()", Matrix),
    ("methods/generalized_alpha.hpp", "0.5 + alpha_f - alpha_m", "0.5 - alpha_f + alpha_m", "double"),
    ("methods/generalized_alpha.hpp", "0.5 - velocity_share", "0.5 + velocity_share", "double"),
    ("methods/rkmk.hpp", "h_ * (slope(0)[i] + slope(end())[i])", "-h_ * (slope(0)[i] + slope(end())[i])", "double"),
    ("methods/joint_chart.hpp", "2 * point.rate[i] * swing.cross(link.axis)", "point.rate[i] * swing.cross(link.axis)",
     Vector),
    ("methods/joint_chart.hpp", "link.mass * link.w.cross(link.w.cross(centre)) - f.v", "-f.v", Vector),
    ("methods/joint_chart.hpp", "link.F - K.transpose() * link.N + C * link.bent", "link.F - K.transpose() * link.N",
     Vector),
    ("methods/motion_series.hpp", "-(k + 1) * gamma", "-(k + 2) * gamma", Vector),
    ("methods/motion_series.hpp", "point.cross(seen_from(R, load.force)) + seen_from(R, load.torque)",
     "point.cross(seen_from(R, load.force))", Vector),
    ("methods/term_series.hpp", "spring->damping * (k + 1)", "spring->damping * k", "double"),
    ("methods/contact_series.hpp", "0.5 * j - k", "0.5 * j + k", "double"),
    ("methods/turning.hpp", "r[0] * F[1] - r[1] * F[0]", "r[0] * F[1] + r[1] * F[0]", "double"),
    ("methods/extrapolation.hpp", "(entry - above) * (n - k) / k", "(entry - above) * n / k", "double"),
    ("solve/saddle_solver.hpp", "-joints[plan_.parts[k]].drift(plan_.part(k))",
     "joints[plan_.parts[k]].drift(plan_.part(k))", Vector),
    ("methods/euler_lagrange.hpp", "w.cross(y) - angular_momentum(system_.bodies[b], w).cross(rate)", "w.cross(y)",
     Vector),
    ("solve/small_schur.hpp", "times(side.H.w, lam)", "times(side.H.w.transpose(), lam)", Vector),
    ("solve/independent_rows.hpp", "lengths[c] / lengths[kept[k]]", "lengths[kept[k]] / lengths[c]", "double"),
    ("solve/free_bodies.hpp", "a.dot(b) * residual", "0", "double"),
    ("linalg/compensated.hpp", "(before - (sum - seen)) + (whole - seen)", "(before - (sum - seen)) - (whole - seen)",
     "Values"),
)
TESTS = ("constraints", "so3", "adapter", "oracle", "methods", "taylor", "rkmk", "driven", "rolling", "mimic",
         "armature", "generalized_alpha", "redundant", "many_loops", "planar", "projection", "seulex", "joint_tree",
         "spin_free", "free_bodies", "compositions", "correction", "integrate", "breaks")
FIRST = {"axis_rows": "driven", "forces": "adapter", "contact": "rolling", "so3": "so3", "mimic": "mimic",
         "time_function": "breaks", "plan": "breaks",
         "body_chart": "rkmk", "euler_lagrange": "oracle", "euler_hamilton": "oracle",
         "unstabilised": "oracle", "rattle": "rolling",
         "generalized_alpha": "generalized_alpha", "system": "spin_free", "rkmk": "rkmk", "joint_chart": "joint_tree",
         "motion_series": "taylor", "term_series": "taylor", "contact_series": "rolling", "turning": "planar",
         "extrapolation": "seulex", "saddle_solver": "driven", "small_schur": "taylor",
         "independent_rows": "redundant", "free_bodies": "free_bodies", "compensated": "compositions"}
"""The test to begin with, by the file of a mutant."""
SECONDS = 300
"""Computing (s) of a test file after which it counts as failed: it runs on."""
SWITCH = """// Which wrong equation counts.
#pragma once
#include <cstdlib>
inline bool seeded(int number) {
  static const char* const given = std::getenv("CORE_MUTANT");
  static const int wanted = given ? std::atoi(given) : -1;
  return number == wanted;
}
"""


def seed(folder: Path) -> None:
    """A copy of the sources with all mutants."""
    shutil.copy(ROOT / "CMakeLists.txt", folder)
    core = shutil.copytree(ROOT / "lieeuler" / "_core", folder / "lieeuler" / "_core")
    (core / "seeded.hpp").write_text(SWITCH)
    for number, (name, right, wrong, kind) in enumerate(MUTANTS):
        text = (core / name).read_text()
        if text.count(right) != 1:
            sys.exit(f"mutant {number}: {name} has `{right}` {text.count(right)} times, not once")
        text = text.replace(right, f"(seeded({number}) ? {kind}({wrong}) : {kind}({right}))")
        (core / name).write_text(text.replace("#pragma once", '#pragma once\n#include "seeded.hpp"', 1))


def build(folder: Path) -> None:
    """The kernel with all mutants, in `folder`."""
    seed(folder)
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    for command in (["-S", folder, "-B", folder, "-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}"],
                    ["--build", folder]):
        subprocess.run(["cmake", *command], check=True, stdout=subprocess.DEVNULL, env={**os.environ, "PATH": path})


@functools.cache
def fails(folder: Path, name: str, number: int) -> bool:
    """Whether a test file fails with this mutant, -1: without any."""
    files = (["tests/adapters/test_lieeuler.py"] if name == "adapter" else
             [str(folder / f"test_{name}.py") for folder in (Path("tests/lieeuler"), Path("tests/adapters/lieeuler"))
              if (ROOT / folder / f"test_{name}.py").exists()])
    command = [ROOT / "tools" / "with_kernel", folder, "-x", "-q", "-m", "not study", *files]
    try:
        subprocess.run(command, capture_output=True, check=True,
                       preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS)),
                       env={**os.environ, "CORE_MUTANT": str(number), "PY": sys.executable})
    except subprocess.CalledProcessError:  # it fails, or runs on for ever
        return True
    return False


def notices(folder: Path, number: int) -> str | None:
    """The first test file that fails with this mutant and passes without."""
    first = FIRST.get(Path(MUTANTS[number][0]).stem)
    for name in sorted(TESTS, key=lambda each: each != first):
        if fails(folder, name, -1):
            sys.exit(f"test_{name} fails without any mutant")
        if fails(folder, name, number):
            return name
    return None


def main() -> int:
    """Print every mutant, and how many live."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=int, nargs="*", default=range(len(MUTANTS)))
    parser.add_argument("--kernel", type=Path, help="folder to build in, or that holds this kernel already")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.kernel or Path(temporary)
        if not any(folder.glob("_kernel.*")):
            folder.mkdir(exist_ok=True)
            build(folder)
        alive = 0
        for number in options.only:
            killer = notices(folder, number)
            alive += killer is None
            name, right, wrong, _ = MUTANTS[number]
            print(f"{number} {f'killed by {killer}' if killer else 'ALIVE'} {name}: {right} -> {wrong}", flush=True)
    print(f"{alive} of {len(options.only)} live")
    return 0


if __name__ == "__main__":
    sys.exit(main())
