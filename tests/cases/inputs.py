"""Files of robots, scenes and logs as strangers write them; their motions by SciPy, MuJoCo and closed forms alone."""

from __future__ import annotations

import json

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from crosscheck.scene.building import scene_from

Z = [0.0, 0.0, 1.0]


# --- files --------------------------------------------------------------------------------------------------------


def table(path, columns, separator=",", comma=False, digits=12, quoted=False):
    """Columns by name as text; `comma`: decimal commas."""
    rows = zip(*columns.values(), strict=True)
    text = "\n".join(separator.join(f"{value:.{digits}g}" for value in row) for row in rows)
    header = separator.join(f'"{name}"' if quoted else name for name in columns)
    path.write_text(f"{header}\n{text.replace('.', ',') if comma else text}\n", encoding="utf-8")


def opensim(path, columns, *preamble):
    """A file of OpenSim with these lines before `endheader`."""
    table(path, columns, "\t")
    head = [path.stem, "version=1", f"nRows={len(columns['time'])}", f"nColumns={len(columns)}", *preamble, "endheader"]
    path.write_text("\n".join(head) + "\n" + path.read_text(encoding="utf-8"), encoding="utf-8")


def link(name, mass, centre, moments, collision=""):
    ixx, iyy, izz = moments
    return (f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/><inertia ixx="{ixx}" '
            f'iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>{collision}</link>')


def shape(geometry, place="0 0 0"):
    return f'<collision><origin xyz="{place}"/><geometry>{geometry}</geometry></collision>'


def joined(name, kind, parent, child, place, axis, more=""):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/>{more}</joint>')


def gantry(friction=6.0, effort=200.0, speed=0.4, start=0.0, shapes=False):
    """A bridge along x with a hoist along z."""
    ball, slab = (shape('<sphere radius=".1"/>'), shape('<box size="2 1 .1"/>')) if shapes else ("", "")
    dry = f'<dynamics damping="{0 if shapes else 12}" friction="{friction}"/>'
    limit = f'<limit lower="-2" upper="2" effort="{effort}" velocity="{speed}"/>'
    return ('<robot name="gantry">' + link("base", 9, "0 0 0", (1, 1, 1), slab)
            + link("bridge", 3.5, "0 0 .1", (0.04, 0.05, 0.06)) + link("hook", 1.5, "0 0 0", (0.01, 0.01, 0.01), ball)
            + joined("bridge_x", "prismatic", "base", "bridge", "0 0 0", "1 0 0", limit + ("" if shapes else dry))
            + joined("hoist_z", "prismatic", "bridge", "hook", f"0 0 {start}", "0 0 1", limit) + "</robot>")


def leg(shoulder=0.0, elbow=0.0, shapes=False):
    """Two hinges about y, dampers in both; a ball at the tip and one on the base below."""
    tip, below = (shape('<sphere radius=".05"/>', "0 0 -.3"), shape('<sphere radius=".08"/>', "0 0 .3")
                  ) if shapes else ("", "")
    return ('<robot name="leg">' + link("base", 5, "0 0 .2", (0.1, 0.1, 0.1), below)
            + link("thigh", 0.9, "0 .01 -.2", (0.012, 0.013, 0.002)) + link("shin", 0.6, "0 0 -.15", (
                0.006, 0.007, 0.001), tip)
            + joined("hip", "continuous", "base", "thigh", "0 0 1", "0 1 0", f'<dynamics damping="{shoulder}"/>')
            + joined("knee", "continuous", "thigh", "shin", "0 0 -.4", "0 1 0", f'<dynamics damping="{elbow}"/>')
            + "</robot>")


CART = """<mujoco model="cart"><option gravity="0 0 -9.81"/><worldbody><body name="box">
<joint name="cart" type="slide" axis="1 0 0" stiffness="30" damping="{damping}"/>
<inertial pos="0 0 0" mass="2" diaginertia=".01 .02 .02"/></body></worldbody></mujoco>"""


def cart(t, damping=0.7, start=(0.3, 0.1)):
    """Position and velocity of the sprung and damped cart."""
    from scipy.linalg import expm

    return np.array([expm(np.array([[0.0, 1.0], [-15.0, -damping / 2]]) * at) @ start for at in t]).T


# --- motions ------------------------------------------------------------------------------------------------------


def solved(rate, start, times, **options):
    """Columns of the solution of an initial value problem at the times."""
    done = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13, **options)
    return done.y


def simulated(text, times, qpos=None, qvel=None, key=None, step=1e-3, integrator="RK4"):
    """MuJoCo's qpos and qvel at the times, and when it first reports a contact (nan: never)."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = step, getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data = mujoco.MjData(model)
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
    data.qpos[:] = data.qpos if qpos is None else qpos
    data.qvel[:] = data.qvel if qvel is None else qvel
    kept, touched = [], np.nan
    for k in range(round(times[-1] / step) + 1):
        if np.any(np.abs(times - k * step) < step / 4):
            kept.append(np.concatenate([data.qpos, data.qvel]))
        mujoco.mj_step(model, data)
        if data.ncon and np.isnan(touched):
            touched = (k + 1) * step
    return np.array(kept).T[:model.nq], np.array(kept).T[model.nq:], touched


def thrown(times, moments, x, v, q, w):
    """A free body under gravity: places and velocities of its centre of mass, attitudes, rates in its axes.

    `q`: the quaternion at the start, w first.
    """
    moments = np.asarray(moments)

    def rate(_, y):
        turned = np.array([-y[1:4] @ y[4:], *(y[0] * y[4:] + np.cross(y[1:4], y[4:]))]) / 2
        return np.concatenate([turned, -np.cross(y[4:], moments * y[4:]) / moments])

    y = solved(rate, [*q, *w], times)
    t, g = np.asarray(times)[:, None], np.array([0.0, 0.0, -9.81])
    return x + v * t + g * t**2 / 2, v + g * t, Rotation.from_quat(y[:4].T, scalar_first=True), y[4:].T


# --- scenes -------------------------------------------------------------------------------------------------------


def body(name, mass=1.0, moments=(0.1, 0.1, 0.1), **keys):
    return {"name": name, "mass": mass, "inertia": np.diag(moments).tolist(), **keys}


def joint(name, kind, child, axis=Z, parent="ground", place=(0.0, 0.0, 0.0), arm=(0.0, 0.0, 0.0), **keys):
    axis, place, arm = ([float(part) for part in vector] for vector in (axis, place, arm))
    axes = {"parent_axis": axis, "child_axis": axis} if kind != "spherical" else {}
    return {"name": name, "type": kind, "parent": parent, "child": child, "parent_anchor": place, "child_anchor": arm,
            **axes, **keys}


def made(bodies, joints, duration=1.0, samples=11, gravity=0.0, axis=2, **tables):
    """The content of a scene file."""
    pull = [0.0, 0.0, 0.0]
    pull[axis] = gravity
    return {"schema": 3, "name": "made", "gravity": pull, "duration": duration, "samples": samples, "bodies": bodies,
            "joints": joints, **tables}


def scene(*given, **keys):
    return scene_from(made(*given, **keys), "made")


def written(path, *given, **keys):
    """A scene file in JSON."""
    path.write_text(json.dumps(made(*given, **keys)), encoding="utf-8")
