"""Made-up machines and their logs: MuJoCo moves a robot under a controller, and an encoder, a clock and a network spoil
what is recorded. Nothing here knows how a log is judged.

A log is a dict of columns: time, positions and the commanded torque of each joint.
"""

from __future__ import annotations

import dataclasses

import numpy as np

ARM = """<mujoco><option timestep="{h}" integrator="RK4" gravity="{gx} 0 {gz}"/><worldbody>
<body name="upper" pos="0 0 1.2"><joint name="shoulder" axis="0 1 0" damping="{d1}" frictionloss="{f1}"/>
<inertial pos="{c1} 0 -0.21" mass="{m1}" diaginertia="0.011 {i1} 0.0015"/>
<body name="lower" pos="0 0.05 -0.33"><joint name="elbow" axis="0 1 0" damping="{d2}" armature="{a2}"
frictionloss="{f2}"/>
<inertial pos="{c2} 0 {z2}" mass="{m2}" diaginertia="0.007 0.0075 0.001"/></body></body></worldbody></mujoco>"""
WRIST = """<mujoco><option timestep="{h}" integrator="RK4" gravity="{gx} 0 {gz}"/><worldbody>
<body name="upper" pos="0 0 0.4"><joint name="shoulder" axis="0 0 1" damping="{d1}" frictionloss="{f1}"/>
<inertial pos="{c1} 0.02 0.1" mass="{m1}" diaginertia="0.02 0.02 {i1}"/>
<body name="lower" pos="0.1 0 0.2"><joint name="elbow" axis="0 1 0" damping="{d2}" armature="{a2}"
frictionloss="{f2}"/>
<inertial pos="{c2} 0 {z2}" mass="{m2}" diaginertia="0.01 0.012 0.002"/></body></body></worldbody></mujoco>"""
RAIL = """<mujoco><option timestep="{h}" integrator="RK4" gravity="{gx} 0 {gz}"/><worldbody>
<body name="upper"><joint name="shoulder" type="slide" axis="1 0 0" damping="{d1}" frictionloss="{f1}"/>
<inertial pos="{c1} 0 0" mass="{m1}" diaginertia="0.02 {i1} 0.02"/>
<body name="lower"><joint name="elbow" axis="0 1 0" damping="{d2}" armature="{a2}"
frictionloss="{f2}"/>
<inertial pos="{c2} 0 {z2}" mass="{m2}" diaginertia="0.004 0.004 0.0005"/></body></body></worldbody></mujoco>"""
FENCED = ARM.replace("</body></body>", """<geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0"/>
</body></body>""").replace("<worldbody>", """<worldbody>
<geom name="wall" type="box" pos="0.3 0 0.7" size="0.05 0.3 0.5"/>""")
PLANS = {"arm": ARM, "wrist": WRIST, "rail": RAIL, "fenced": FENCED}
USUAL = {"h": 1e-3, "gx": 0.0, "gz": -9.81, "m1": 0.9, "i1": 0.012, "d1": 0.08, "f1": 0.0, "c1": 0.0, "m2": 0.55,
         "d2": 0.05, "a2": 0.01, "f2": 0.0, "c2": 0.0, "z2": -0.16}


def model(plan: str, **changed: float) -> str:
    """The model file of a machine, in MuJoCo's format."""
    return PLANS[plan].format(**USUAL | changed)


@dataclasses.dataclass(frozen=True)
class Spoiled:
    """What comes between a machine and its log."""

    noise: float = 1e-3  # rad or m, standard deviation
    quantum: float = 0.0  # step of the encoder
    jitter: float = 0.0  # s, of the times of rows, which are recorded as they are
    dropped: float = 0.0  # share of the rows that are lost
    delay: float = 0.0  # s, from a command to its effect
    gains: tuple[float, float] = (1.0, 1.0)  # what a motor gives of what it is told
    offsets: tuple[float, float] = (0.0, 0.0)
    zeros: tuple[float, float] = (0.0, 0.0)  # of encoders
    rate: float = 200.0  # rows a second
    held: int = 1  # rows for which a command is held
    rates: float = 0.0  # rad/s or m/s, standard deviation of recorded rates; 0: none are
    most: float = np.inf  # N m, what the motor of the elbow gives at most
    load: tuple[float, float] = (0.0, 0.0)  # kg at the centre of mass of the lower body, and from when on (s)
    signs: tuple[float, float] = (1.0, 1.0)  # of encoders


def log(plan: str, seed: int, spoiled: Spoiled, duration: float = 4.0, **changed: float) -> dict[str, np.ndarray]:
    """The log of a machine whose numbers are changed, under a controller that knows nothing of that."""
    import mujoco

    rng, of_rates = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    fine = 2.5e-4
    machine = mujoco.MjModel.from_xml_string(model(plan, **changed | {"h": fine}))
    data = mujoco.MjData(machine)
    amplitude, speed, phase = rng.uniform(0.3, 0.7, 4), rng.uniform(2.0, 6.0, 4), rng.uniform(0.0, 6.3, 4)
    stiff, soft = np.array([25.0, 12.0]), np.array([1.0, 0.4])

    def wanted(t: float) -> np.ndarray:
        return (amplitude * np.sin(speed * t + phase)).reshape(2, 2).sum(axis=1)

    data.qpos[:] = wanted(0.0)
    told, rows, due, count = np.zeros(2), [], 0.0, 0
    queue = [(-1.0, told)]
    for k in range(int(duration / fine)):
        t = k * fine
        if t >= due - 1e-9:
            seen = data.qpos + spoiled.zeros + spoiled.noise * rng.standard_normal(2)
            if spoiled.quantum:
                seen = np.round(seen / spoiled.quantum) * spoiled.quantum
            if count % spoiled.held == 0:
                told = stiff * (wanted(t) - seen) - soft * data.qvel
                queue.append((t + spoiled.delay, told))
            count += 1
            if rng.uniform() >= spoiled.dropped:
                rates = data.qvel + spoiled.rates * of_rates.standard_normal(2)
                rows.append([t, *(seen * spoiled.signs), *told, *rates])
            due += max(1, round((1.0 / spoiled.rate + spoiled.jitter * rng.uniform(-1.0, 1.0)) / fine)) * fine
        while len(queue) > 1 and queue[1][0] <= t + 1e-9:
            queue.pop(0)
        data.qfrc_applied[:] = np.array(spoiled.gains) * queue[0][1] + spoiled.offsets
        data.qfrc_applied[1] = np.clip(data.qfrc_applied[1], -spoiled.most, spoiled.most)
        if spoiled.load[0] and abs(t - spoiled.load[1]) < 0.5 * fine:
            machine.body_mass[2] += spoiled.load[0]
        mujoco.mj_step(machine, data)
    names = ["time", "shoulder_pos", "elbow_pos", "shoulder_torque", "elbow_torque", "shoulder_vel", "elbow_vel"]
    return dict(zip(names[:None if spoiled.rates else 5], np.array(rows).T, strict=False))


LOW, USUALLY, HIGH = 2e-4, 1e-3, 4e-3
"""Noise of three sizes."""

RIGHT = [
    ("arm", Spoiled(LOW)), ("arm", Spoiled(USUALLY)), ("arm", Spoiled(HIGH)), ("wrist", Spoiled(LOW)),
    ("wrist", Spoiled(USUALLY, dropped=0.02)), ("rail", Spoiled(LOW)), ("rail", Spoiled(USUALLY, jitter=1e-3)),
    ("arm", Spoiled(0.0, quantum=2 * np.pi / 8192)), ("wrist", Spoiled(HIGH, rate=400.0)),
    ("arm", Spoiled(LOW, rate=100.0))]
"""Logs of machines that are as their models say."""

WRONG = [  # the mistake, as the cause should name it; what the machine has, beside its model; what spoils the log
    ("mass of lower", {"m2": 0.6}, "arm", Spoiled(LOW)),
    ("mass of lower", {"m2": 0.65}, "wrist", Spoiled(USUALLY)),
    ("mass of upper", {"m1": 1.1}, "rail", Spoiled(USUALLY)),
    ("damping of elbow", {"d2": 0.1}, "arm", Spoiled(USUALLY)),
    ("damping of shoulder", {"d1": 0.2}, "wrist", Spoiled(LOW)),
    ("damping of shoulder", {"d1": 0.3}, "rail", Spoiled(USUALLY)),
    ("armature of elbow", {"a2": 0.015}, "arm", Spoiled(LOW)),
    ("armature of elbow", {"a2": 0.02}, "rail", Spoiled(USUALLY)),
    ("dry friction of elbow", {"f2": 0.1}, "arm", Spoiled(LOW)),
    ("dry friction of shoulder", {"f1": 0.2}, "wrist", Spoiled(LOW)),
    ("delay of the inputs", {}, "arm", Spoiled(LOW, delay=5e-3)),
    ("delay of the inputs", {}, "wrist", Spoiled(USUALLY, delay=1e-2)),
    ("torque gain of elbow", {}, "arm", Spoiled(USUALLY, gains=(1.0, 0.9))),
    ("torque gain of shoulder", {}, "wrist", Spoiled(LOW, gains=(1.05, 1.0))),
    ("torque offset of elbow", {}, "rail", Spoiled(LOW, offsets=(0.0, 0.1))),
    ("zero of elbow's encoder", {}, "arm", Spoiled(USUALLY, zeros=(0.0, 0.05))),
    ("the base turned about y", {"gx": 0.3}, "rail", Spoiled(LOW)),
    ("centre of mass z of lower", {"z2": -0.2}, "arm", Spoiled(HIGH)),
    ("centre of mass x of lower", {"c2": 0.03}, "wrist", Spoiled(USUALLY, dropped=0.02)),
    ("inertia of upper", {"i1": 0.0098}, "arm", Spoiled(LOW, quantum=1e-4))]
"""Logs of machines that are not."""
