"""Motions and their files, made without crosscheck and lieeuler: SciPy on equations written by hand, and two engines.

Each motion is a dict of columns by the names that a recording of its scene has; parameters make it wrong.
"""

from __future__ import annotations

import json

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

Y = [0.0, 1.0, 0.0]


def toml(name, *tables, schema=2):
    """The text of a scene of two seconds; each table is a pair of its name and its entries."""
    lines = [f"schema = {schema}", f'name = "{name}"', "gravity = [0.0, 0.0, -9.81]", "duration = 2.0", "samples = 101"]
    for table, entries in tables:
        lines += [f"[[{table}]]", *(f"{key} = {inline(value) if isinstance(value, dict) else json.dumps(value)}"
                                        for key, value in entries.items())]
    return "\n".join(lines) + "\n"


def solid(name, mass, J, **more):
    """A body with principal moments J."""
    return "bodies", {"name": name, "mass": mass, "inertia": np.diag(J).tolist(), **more}


def joint(name, kind, parent, child, parent_anchor, child_anchor, axis=None, **more):
    """A joint whose axis, if it has one, is the same in both bodies."""
    axes = {} if axis is None else {"parent_axis": axis, "child_axis": axis}
    return "joints", {"name": name, "type": kind, "parent": parent, "child": child, "parent_anchor": parent_anchor,
                      "child_anchor": child_anchor, **axes, **more}


def inline(entries):
    """Inline TOML of a dict."""
    return "{ " + ", ".join(f"{key} = {json.dumps(value)}" for key, value in entries.items()) + " }"


BAR, BRICK = (0.01, 0.03, 0.025), (0.03, 0.05, 0.07)


def hinged(**more):
    """A bar on a hinge."""
    return solid("bar", 1.2, BAR), joint("pivot", "revolute", "ground", "bar", [0.1, 0.0, 0.2], [-0.4, 0.0, 0.0], Y,
                                         position=0.4, velocity=1.5, damping=0.02, **more)


ARM = hinged()
SERVO = {"type": "servo", "joint": "pivot", "target": -0.5, "proportional": 30.0, "derivative": 1.0}
BLOCK = solid("block", 2.0, BRICK)
RAIL = "rail", "prismatic", "ground", "block", [0.0] * 3, [0.0] * 3, [1.0, 0.0, 0.0]
CHIP = (("sites", {"name": "chip", "body": "bar", "position": [0.2, 0.0, 0.05]}),
        ("sensors", {"name": "acceleration", "type": "accelerometer", "site": "chip"}),
        ("sensors", {"name": "rate", "type": "angular_velocity", "site": "chip", "frame": "site"}))
SCENES = {
    "arm": toml("arm", *ARM),
    "two": toml("two", solid("upper", 1.2, BAR), solid("fore", 0.7, (0.004, 0.012, 0.011)),
                joint("shoulder", "revolute", "ground", "upper", [0.0] * 3, [-0.4, 0.0, 0.0], Y, position=0.4,
                      velocity=1.5),
                joint("elbow", "revolute", "upper", "fore", [0.4, 0.0, 0.0], [-0.3, 0.0, 0.0], Y, position=-0.7,
                      velocity=-1.0)),
    "tumbler": toml("tumbler", solid("brick", 2.0, BRICK, attitude=[0.8, 0.36, -0.48, 0.0], position=[0.2, -0.1, 5.0],
                                     angular_velocity=[1.0, 2.5, -0.6], velocity=[1.0, 0.5, 3.0])),
    "top": toml("top", solid("top", 1.5, (0.02, 0.03, 0.015), attitude=[0.9, 0.3, 0.3, 0.1],
                             angular_velocity=[0.5, -0.3, 6.0]),
                joint("tip", "spherical", "ground", "top", [0.0] * 3, [0.0, 0.0, -0.5])),
    "slider": toml("slider", BLOCK, joint(*RAIL, position=0.3, velocity=-0.5), ("forces", {
        "type": "linear_spring", "parent": "ground", "child": "block", "parent_point": [-1.0, 0.0, 0.0],
        "child_point": [0.0] * 3, "stiffness": 80.0, "free_length": 0.9, "damping": 0.4})),
    "sled": toml("sled", BLOCK, joint(*RAIL, position=0.3, velocity=1.5, dry_friction=2.0), schema=3),
    "imu": toml("imu", *ARM, *CHIP, schema=3),
    "rough": toml("rough", *hinged(dry_friction=1.5), schema=3),
    "bounce": toml("bounce", *hinged(limits={"upper": 0.9, "restitution": 0.5}), schema=3),
    "stop": toml("stop", *hinged(limits={"upper": 0.9}), schema=3),
    "soft": toml("soft", *hinged(limits={"upper": 0.9, "stiffness": 60.0, "damping": 0.4}), schema=3),
    "servo": toml("servo", *hinged(), ("forces", SERVO | {"effort_limit": 6.0}), schema=3),
    "sampled": toml("sampled", *hinged(), ("forces", SERVO | {"effort_limit": 6.0, "period": 0.02, "delay": 1}),
                    schema=3)}

TIMES = np.linspace(0.0, 2.0, 201)


def solved(rates, y0, t):
    """States (T, k) of an ordinary differential equation."""
    y = np.tile(np.array(y0, dtype=float), (len(t), 1))
    for side, order in ((t < 0, -1), (t > 0, 1)):
        if side.any():
            times = t[side][::order]
            made = solve_ivp(rates, (0.0, times[-1]), y0, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
            y[side] = made.y.T[::order]
    return y


def turned_y(angle):
    """Rotations (T, 3, 3) about y."""
    return Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0])).as_matrix()


def body(columns, name, x, R, v, w):
    """Put the columns of one body into `columns`, attitudes as quaternions."""
    q = Rotation.from_matrix(R).as_quat(scalar_first=True)
    flips = np.cumprod(np.concatenate([[1.0], np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)]))
    q = q * flips[:, None]
    for part, values in (("", x), ("v", v), ("w", w)):
        columns |= {f"{name}.{part}{axis}": values[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"{name}.q{axis}": q[:, k] for k, axis in enumerate("wxyz")}


def arm(t=TIMES, g=9.81, m=1.2, J=0.03, l=0.4, anchor=(0.1, 0.0, 0.2), angle=0.4, rate=1.5, damping=0.02, square=0.0):
    """A bar on a hinge about y: (J + m l^2) a = m g l cos(a) - damping, with z up and a turn that lowers the bar."""
    def rates(_, y):
        return [y[1], (m * g * l * np.cos(y[0]) - damping * y[1] - square * abs(y[1]) * y[1]) / (J + m * l * l)]

    a, w = solved(rates, [angle, rate], t).T
    R = turned_y(a)
    spin = np.outer(w, [0.0, 1.0, 0.0])
    lever = R @ np.array([l, 0.0, 0.0])
    columns = {"t": t, "pivot.position": a, "pivot.velocity": w}
    body(columns, "bar", np.array(anchor) + lever, R, np.cross(spin, lever), spin)
    return columns


def imu(t=TIMES, g=9.81, s=(0.2, 0.0, 0.05)):
    """What an accelerometer and a gyroscope at the point s of that bar read: no joint, no body."""
    columns = arm(t, g)
    angle, rate = columns["pivot.position"], columns["pivot.velocity"]
    swing = (1.2 * g * 0.4 * np.cos(angle) - 0.02 * rate) / (0.03 + 1.2 * 0.16)
    x, z = 0.4 + s[0], s[2]
    made = {"t": t, "acceleration.x": swing * z - rate**2 * x - g * np.sin(angle), "acceleration.y": 0.0 * t,
            "acceleration.z": -swing * x - rate**2 * z + g * np.cos(angle)}
    return made | {f"rate.{axis}": value for axis, value in zip("xyz", (0.0 * t, rate, 0.0 * t), strict=True)}


def two(t=TIMES, g=9.81, m=(1.2, 0.7), J=(0.03, 0.012), l=(0.4, 0.8, 0.3), angle=(0.4, -0.7), rate=(1.5, -1.0),
        damping=0.0):
    """Two bars on parallel hinges: Lagrange's equations in absolute angles a, b."""
    l1, L, l2 = l

    def rates(_, y):
        a, b, p, q = y
        c, s = np.cos(a - b), np.sin(a - b)
        M = np.array([[J[0] + m[0] * l1**2 + m[1] * L**2, m[1] * L * l2 * c],
                      [m[1] * L * l2 * c, J[1] + m[1] * l2**2]])
        f = np.array([-m[1] * L * l2 * s * q * q + (m[0] * l1 + m[1] * L) * g * np.cos(a) - damping * (2 * p - q),
                      m[1] * L * l2 * s * p * p + m[1] * l2 * g * np.cos(b) - damping * (q - p)])
        return [p, q, *np.linalg.solve(M, f)]

    a, b, p, q = solved(rates, [angle[0], sum(angle), rate[0], sum(rate)], t).T
    columns = {"t": t, "shoulder.position": a, "shoulder.velocity": p, "elbow.position": b - a, "elbow.velocity": q - p}
    one, other = turned_y(a), turned_y(b)
    spins = np.outer(p, [0.0, 1.0, 0.0]), np.outer(q, [0.0, 1.0, 0.0])
    reach, end = one @ np.array([L, 0.0, 0.0]), other @ np.array([l2, 0.0, 0.0])
    half = one @ np.array([l1, 0.0, 0.0])
    body(columns, "upper", half, one, np.cross(spins[0], half), spins[0])
    body(columns, "fore", reach + end, other, np.cross(spins[0], reach) + np.cross(spins[1], end), spins[1])
    return columns


def spinning(J, torque, R0, w0, t, gyroscopic=1.0):
    """(R, w) of Euler's equations J w' = torque(R, w) - w x J w with R' = R hat(w), attitudes as nine numbers."""
    J = np.asarray(J)

    def rates(_, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.concatenate([np.cross(R, w).ravel(), np.linalg.solve(J, torque(R, w)
                                                                       - gyroscopic * np.cross(w, J @ w))])

    y = solved(rates, np.concatenate([R0.ravel(), w0]), t)
    return y[:, :9].reshape(-1, 3, 3), y[:, 9:]


def tumbler(t=TIMES, g=(0.0, 0.0, -9.81), J=(0.03, 0.05, 0.07), q=(0.8, 0.36, -0.48, 0.0), w=(1.0, 2.5, -0.6),
            x=(0.2, -0.1, 5.0), v=(1.0, 0.5, 3.0), drag=0.0, gyroscopic=1.0):
    """A free body: a parabola, and Euler's equations."""
    R0 = Rotation.from_quat(q, scalar_first=True).as_matrix()
    R, spin = spinning(np.diag(J), lambda R, w: -drag * np.diag(J) @ w, R0, np.array(w), t, gyroscopic)
    g = np.array(g)
    columns = {"t": t}
    if drag:
        y = solved(lambda _, y: np.concatenate([y[3:], g - drag * y[3:]]), np.array([*x, *v]), t)
        body(columns, "brick", y[:, :3], R, y[:, 3:], spin)
    else:
        body(columns, "brick", np.array(x) + np.outer(t, v) + 0.5 * np.outer(t * t, g), R,
             np.array(v) + np.outer(t, g), spin)
    return columns


def top(t=TIMES, g=(0.0, 0.0, -9.81), m=1.5, J=((0.02, 0, 0), (0, 0.03, 0), (0, 0, 0.015)), s=(0.0, 0.0, 0.5),
        q=(0.9, 0.3, 0.3, 0.1), w=(0.5, -0.3, 6.0), pivot=(0.0, 0.0, 0.0), damping=0.0, gyroscopic=1.0):
    """A body on a ball joint, about which its inertia is J + m (s^2 - s s^T)."""
    s, g = np.array(s), np.array(g)
    about = np.array(J, dtype=float) + m * (s @ s * np.eye(3) - np.outer(s, s))
    R0 = Rotation.from_quat(q, scalar_first=True).as_matrix()
    R, spin = spinning(about, lambda R, w: np.cross(s, R.T @ (m * g)) - damping * w, R0, np.array(w), t, gyroscopic)
    columns = {"t": t}
    body(columns, "top", np.array(pivot) + R @ s, R, np.einsum("tij,tj->ti", R, np.cross(spin, s)), spin)
    return columns


def slider(t=TIMES, m=2.0, k=80.0, free=0.9, c=0.4, x0=0.3, v0=-0.5, coulomb=0.0):
    """A block on a spring and damper, in closed form; y and z stay."""
    rest, beta = free - 1.0, c / (2 * m)
    if coulomb:
        def rates(_, y):
            return [y[1], (-k * (y[0] - rest) - c * y[1] - coulomb * np.tanh(1e3 * y[1])) / m]

        y = solved(rates, [x0, v0], t)
        x, v = y.T
    else:
        omega = np.sqrt(k / m - beta**2)
        a, b = x0 - rest, (v0 + beta * (x0 - rest)) / omega
        wave, slope = np.exp(-beta * t), np.cos(omega * t)
        x = rest + wave * (a * slope + b * np.sin(omega * t))
        v = wave * ((b * omega - beta * a) * slope - (a * omega + beta * b) * np.sin(omega * t))
    still = np.zeros((len(t), 3))
    columns = {"t": t, "rail.position": x, "rail.velocity": v}
    body(columns, "block", np.outer(x, [1.0, 0.0, 0.0]), np.broadcast_to(np.eye(3), (len(t), 3, 3)),
         np.outer(v, [1.0, 0.0, 0.0]), still)
    return columns


def sled(t=TIMES, friction=2.0):
    """That block without its spring, with dry friction: it stops, and stays."""
    a = friction / 2.0
    moving = np.minimum(t, 1.5 / a)
    return {"t": t, "rail.position": 0.3 + 1.5 * moving - 0.5 * a * moving**2, "rail.velocity": 1.5 - a * moving}


# --- laws of a hinge --------------------------------------------------------------------------------------------------


def lawful(t=TIMES, g=9.81, J=0.222, damping=0.02, friction=(0.0, 0.0), stop=None, bounce=0.0, soft=None, servo=None,
           late=lambda t: 0.0):
    """The bar on its hinge, with laws: a smooth motion from event to event, each found by SciPy.

    friction : N m, of motion to either side; stop : rad, of a rigid one above, with restitution `bounce`
    soft : (rad, N m/rad, N m s/rad) of a spring and damper above, which push only
    servo : (target, proportional, derivative, limit, period or None, whole periods of delay)
    late : N m more, by time
    """
    now, y, side, held, acting, queue, rows = 0.0, np.array([0.4, 1.5]), 1.0, False, 0.0, [], []
    target, proportional, derivative, limit, period, delay = servo or (0.0,) * 4 + (None, 0)

    def wanted(y):
        return proportional * (target - y[0]) - derivative * y[1]

    def load(t, y):
        push = 0.0 if soft is None or y[0] < soft[0] else max(0.0, soft[1] * (y[0] - soft[0]) + soft[2] * y[1])
        effort = np.clip(wanted(y), -limit, limit) if servo and period is None else acting
        return 1.2 * g * 0.4 * np.cos(y[0]) - damping * y[1] - push + effort + late(t)

    def surfaces():
        if held:  # by the stop until the load turns, by friction until it is too large
            return [lambda t, y: load(t, y) if stop is not None else friction[0] - abs(load(t, y))]
        made = [(lambda t, y: stop - y[0])] if stop is not None else []
        made += [lambda t, y: y[1]] if any(friction) else []
        made += [lambda t, y: soft[0] - y[0],
                 lambda t, y: soft[1] * (y[0] - soft[0]) + soft[2] * y[1]] if soft is not None else []
        made += [lambda t, y: wanted(y) - limit, lambda t, y: wanted(y) + limit] if servo and period is None else []
        return made

    def rates(t, y):
        return [0.0, 0.0] if held else [y[1], (load(t, y) - side * friction[int(side < 0)]) / J]

    sample, next_sample = 0, 0.0
    while now < t[-1]:
        if period is not None and now >= next_sample - 1e-12:
            queue.append(float(np.clip(wanted(y), -limit, limit)))
            acting = queue[-1 - delay] if len(queue) > delay else 0.0
            sample += 1
            next_sample = sample * period
        until = min(t[-1], next_sample) if period is not None else t[-1]
        if until <= now:
            continue
        events = surfaces()
        for event in events:
            event.terminal, event.direction = True, 0.0
        began = solve_ivp(rates, (now, until), y, "DOP853", rtol=1e-12, atol=1e-13, events=events or None,
                          dense_output=True, max_step=0.01)
        inside = t[(t >= now) & (t <= began.t[-1]) & (t > (rows[-1][0] if rows else -1.0))]
        rows += [(each, *began.sol(each)) for each in inside]
        now, y = float(began.t[-1]), began.y[:, -1].copy()
        if began.status != 1:
            continue
        if held:
            held, side = False, np.sign(load(now, y)) or 1.0
        elif stop is not None and abs(stop - y[0]) < 1e-9 and y[1] > 0:
            y = np.array([stop, -bounce * y[1]])
            held = abs(y[1]) < 1e-6 and load(now, y) > 0
            y[1] *= not held
        elif any(friction) and abs(y[1]) < 1e-9:
            y[1], here = 0.0, load(now, y)
            held = abs(here) <= friction[int(here < 0)]
            side = float(np.sign(here))
        if not held:  # away from the surface, by a step that it does not cross
            step = solve_ivp(rates, (now, now + 1e-7), y, "RK45", rtol=1e-12, atol=1e-14)
            now, y = now + 1e-7, step.y[:, -1]
    t, a, w = np.array(rows).T
    columns = {"t": t, "pivot.position": a, "pivot.velocity": w}
    spin, R = np.outer(w, [0.0, 1.0, 0.0]), turned_y(a)
    body(columns, "bar", np.array([0.1, 0.0, 0.2]) + R @ [0.4, 0.0, 0.0], R, np.cross(spin, R @ [0.4, 0.0, 0.0]), spin)
    return columns


# --- engines, by their own scripts ------------------------------------------------------------------------------------

MUJOCO = """<mujoco><option timestep="{step}" integrator="{integrator}"/><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><inertial pos=".4 0 0" mass="1.2" diaginertia=".01 .03 .025"/>
<body name="fore" pos=".8 0 0"><joint name="elbow" axis="0 1 0"/>
<inertial pos=".3 0 0" mass=".7" diaginertia=".004 .012 .011"/></body></body></worldbody></mujoco>"""


def by_mujoco(integrator="RK4", step=1e-3, every=10, count=201, **changes):
    """The two bars by MuJoCo."""
    import mujoco

    text = MUJOCO.format(step=step, integrator=integrator)
    for old, new in changes.get("swap", ()):
        assert old in text
        text = text.replace(old, new)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.4, -0.7), (1.5, -1.0)
    rows = []
    for _ in range(count):
        rows.append([data.time, data.qpos[0], data.qvel[0], data.qpos[1], data.qvel[1]])
        for _ in range(every):
            mujoco.mj_step(model, data)
    names = ["t", "shoulder.position", "shoulder.velocity", "elbow.position", "elbow.velocity"]
    return dict(zip(names, np.array(rows).T, strict=True))


def by_pinocchio():
    """The two bars by Pinocchio's accelerations."""
    import pinocchio as pin

    model = pin.Model()
    one = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "shoulder")
    model.appendBodyToJoint(one, pin.Inertia(1.2, np.array([0.4, 0, 0]), np.diag([0.01, 0.03, 0.025])),
                            pin.SE3.Identity())
    two_ = model.addJoint(one, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.8, 0, 0])), "elbow")
    model.appendBodyToJoint(two_, pin.Inertia(0.7, np.array([0.3, 0, 0]), np.diag([0.004, 0.012, 0.011])),
                            pin.SE3.Identity())
    data = model.createData()
    none = np.zeros(2)

    y = solved(lambda _, y: [*y[2:], *pin.aba(model, data, y[:2], y[2:], none)], [0.4, -0.7, 1.5, -1.0], TIMES)
    return {"t": TIMES, "shoulder.position": y[:, 0], "shoulder.velocity": y[:, 2], "elbow.position": y[:, 1],
            "elbow.velocity": y[:, 3]}


def by_exudyn(step=1e-4, count=201):
    """The free body by Exudyn's explicit integrator."""
    import exudyn as exu
    from exudyn.rigidBodyUtilities import RigidBodyInertia

    SC = exu.SystemContainer()
    mbs = SC.AddSystem()
    R0 = Rotation.from_quat((0.8, 0.36, -0.48, 0.0), scalar_first=True).as_matrix()
    number = mbs.CreateRigidBody(inertia=RigidBodyInertia(2.0, np.diag([0.03, 0.05, 0.07])),
                                 nodeType=exu.NodeType.RotationRxyz, referencePosition=[0.2, -0.1, 5.0],
                                 referenceRotationMatrix=R0,
                                 initialVelocity=[1.0, 0.5, 3.0], gravity=[0, 0, -9.81],
                                 initialAngularVelocity=list(R0 @ np.array([1.0, 2.5, -0.6])))
    outputs = exu.OutputVariableType
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.timeIntegration.verboseMode = 0
    rows = []

    def keep(mbs, t):
        rows.append([t, *(np.ravel(mbs.GetObjectOutputBody(number, kind, [0, 0, 0])) for kind in (
            outputs.Position, outputs.RotationMatrix, outputs.Velocity, outputs.AngularVelocityLocal))])
        return True

    mbs.SetPreStepUserFunction(keep)
    settings.timeIntegration.numberOfSteps = round(2.0 / step) + 1
    settings.timeIntegration.endTime = 2.0 + step
    mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.RK44)
    every = round(2.0 / step / (count - 1))
    rows = rows[::every][:count]
    columns = {"t": np.array([row[0] for row in rows]) - step}  # it tells the end of the step to come
    x, R, v, w = (np.array([row[k] for row in rows]) for k in range(1, 5))
    body(columns, "brick", x, R.reshape(-1, 3, 3), v, w)
    return columns
