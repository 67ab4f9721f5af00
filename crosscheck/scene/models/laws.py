"""Actuators, dry friction, limits and contacts of a compiled MuJoCo model as laws and monitors of a scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from crosscheck.errors import ArgumentError, unknown
from crosscheck.scene import touching
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import LeftOut, quaternion_from_rotation
from crosscheck.scene.models.neutral import Reading, body_label, joints_of, label, off
from crosscheck.scene.models.words import distinct
from crosscheck.scene.schema import Content as Table

MOST_PAIRS = 50_000
"""Most pairs of shapes that are watched; each is a monitor of the scene."""

CHOICES = {"actuators": ("keep", "drop"), "limits": ("monitor", "keep", "drop"), "contacts": ("monitor", "drop"),
           "friction": ("keep", "drop")}
"""What an import does with each, the default first."""

UNREACHABLE = 1e6
"""rad or m. A URDF that needs no limits writes limits at least this far away."""

PASSIVE = ("actuator_damping", "actuator_dampingpoly", "actuator_armature", "actuator_delay")
"""What an actuator may have and a servo has not."""

PLANE = 0
"""mjGEOM_PLANE; two planes do not collide."""

Control = float | Table


@dataclasses.dataclass(frozen=True)
class Wants:
    """What an import keeps, and the controls of actuators, by their numbers in the model once they are found."""

    actuators: str = "keep"
    limits: str = "monitor"
    contacts: str = "monitor"
    friction: str = "keep"
    controls: Mapping[Any, Control] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, allowed in CHOICES.items():
            if getattr(self, key) not in allowed:
                raise ArgumentError(unknown(key, str(getattr(self, key)), allowed))


@dataclasses.dataclass
class Laws:
    """The laws of a model, found once: `table` keys go into the joints, the rest into the file."""

    forces: list[Table] = dataclasses.field(default_factory=list)
    shapes: list[Table] = dataclasses.field(default_factory=list)
    monitors: list[Table] = dataclasses.field(default_factory=list)
    idle: list[str] = dataclasses.field(default_factory=list)  # motors without a control
    motors: list[list[Any]] = dataclasses.field(default_factory=list)  # see `Motor`


def find(reading: Reading, joints: list[Table], wants: Wants) -> Laws:
    """The laws; adds keys to `joints`, what a scene cannot hold to `reading.lost`, what is dropped to `.noted`."""
    laws, places = Laws(), _places(reading, joints)
    _friction(reading, places, wants)
    _limits(reading, places, wants, laws)
    _actuators(reading, places, wants, laws)
    _contacts(reading, wants, laws)
    return laws


def _places(reading: Reading, joints: list[Table]) -> dict[int, tuple[Table, int, float]]:
    """(table, index of the coordinate, its sign) of each joint of the model that is a coordinate of a scene's joint."""
    m, by_child = reading.model, {table["child"]: table for table in joints}
    places: dict[int, tuple[Table, int, float]] = {j: (table, 0, 1.0) for j, table in reading.chained.items()}
    for group, body in reading.bodies.items():
        table = by_child.get(body.name)
        ids = joints_of(m, group)
        if ids and ids[0] in places:
            continue
        if table is None or not JOINT_TYPES[table["type"]].is_elastic:
            continue
        for j in ids:
            k = int(len(ids) == 2 and m.jnt_type[j] == 2)  # the slide of a cylindrical joint comes second
            along = reading.direction(group, reading.data.xaxis[j])
            places[j] = table, k, 1.0 if np.dot(along, table["child_axis"]) > 0 else -1.0
    return places


def _given(table: Table, key: str, k: int, value: Any, other: Any) -> None:
    """Set a key of a joint for one coordinate; `other` is what the other coordinate of a cylindrical joint has."""
    if not JOINT_TYPES[table["type"]].has_one:
        values = table.setdefault(key, [other, other])
        values[k] = value
    else:
        table[key] = value


def _friction(reading: Reading, places: dict[int, tuple[Table, int, float]], wants: Wants) -> None:
    m = reading.model
    if off(m, "FRICTIONLOSS", "CONSTRAINT"):
        return
    for j in sorted({int(m.dof_jntid[dof]) for dof in range(m.nv) if m.dof_frictionloss[dof]}):
        friction = float(m.dof_frictionloss[m.jnt_dofadr[j]])
        mine = LeftOut(label(m, j), "dry friction of joint", friction)
        if wants.friction == "drop":
            reading.noted.append(mine)
        elif j not in places or "mimic" in places[j][0]:
            reading.lost.append(mine)
        else:
            table, k, _ = places[j]
            _given(table, "dry_friction", k, friction, 0.0)


def _limits(reading: Reading, places: dict[int, tuple[Table, int, float]], wants: Wants, laws: Laws) -> None:
    m, d = reading.model, reading.data
    if off(m, "LIMIT", "CONSTRAINT"):
        return
    for j in range(m.njnt):
        reversed_ = bool(m.jnt_range[j, 0] > m.jnt_range[j, 1])  # MuJoCo takes these for none, other engines do not
        if not (m.jnt_limited[j] or reversed_) or np.abs(m.jnt_range[j]).min() >= UNREACHABLE:
            continue
        mine = LeftOut(label(m, j), "limits of joint", tuple(m.jnt_range[j].tolist()))
        if reversed_ and wants.limits != "drop":
            low, high = m.jnt_range[j]
            reading.lost.append(mine._replace(value=f"whose lower end {low:.4g} is above the upper one, {high:.4g}"))
            continue
        if wants.limits == "drop":
            reading.noted.append(mine)
            continue
        table, k, sign = places.get(j, ({}, 0, 1.0))
        if not table or (wants.limits == "monitor" and not JOINT_TYPES[table["type"]].has_one):
            reading.lost.append(mine)
            continue
        lower, upper = sorted(sign * m.jnt_range[j])
        q = sign * float(d.qpos[m.jnt_qposadr[j]])
        if not lower - 1e-8 <= q <= upper + 1e-8:
            reading.lost.append(mine._replace(
                value=f"which starts beyond them, at {q:.4g}, outside {lower:.4g} and {upper:.4g}"))
            continue
        ends = {key: float(end) for key, end in (("lower", lower), ("upper", upper)) if abs(end) < UNREACHABLE}
        if wants.limits == "keep":
            _given(table, "limits", k, ends, {})
        else:
            laws.monitors.append({"type": "range", "joint": table["name"], **ends})


def _actuators(reading: Reading, places: dict[int, tuple[Table, int, float]], wants: Wants, laws: Laws) -> None:
    """Actuators as servos. A motor with no control does nothing and is listed as such."""
    m = reading.model
    on: dict[int, int] = {}
    for a in range(0 if off(m, "ACTUATION") else m.nactuator):
        if int(m.opt.disableactuator) >> int(m.actuator_group[a]) & 1:
            continue
        name, joint, control = str(m.actuator(a).name or ""), joint_of(m, a), wants.controls.get(a)
        mine = LeftOut(name or f"actuator {a}", "actuator", drive(m, a))
        if joint >= 0 and not name:
            mine = LeftOut(label(m, joint), "actuator of joint", mine.value)
        if wants.actuators == "drop":
            if control is not None or acts(reading, a):
                reading.noted.append(mine)
            continue
        servo, motor = _servo(reading, a, places.get(joint), control) or (None, ())
        if motor:
            laws.motors.append([name or motor[0], *motor])
        if servo is None and (control is not None or acts(reading, a)):
            reading.lost.append(mine)
        elif servo is None or (not servo.keys() - {"type", "joint", "effort_limit"} and not acts(reading, a)):
            laws.idle.append(mine.sentence.removeprefix("actuator "))
        else:
            on[joint] = on.get(joint, 0) + 1
            laws.forces.append(servo)
    for j in range(m.njnt):
        if m.nactuator and m.jnt_actfrclimited[j] and (j in on or not m.jnt_actfrcrange[j, 0] <= 0 <= m.jnt_actfrcrange[
                j, 1]):
            _clamp(reading, j, places.get(j), laws, on.get(j, 0))


def drive(m: Any, a: int) -> tuple[float, ...]:
    """Gear, three numbers of the gain and three of the bias of an actuator."""
    return tuple(map(float, (*m.actuator_gear[a, :1], *m.actuator_gainprm[a, :3], *m.actuator_biasprm[a, :3])))


def acts(reading: Reading, a: int) -> bool:
    """Whether an actuator exerts a force at the state's control, or at another state with it."""
    import mujoco

    m, d = reading.model, reading.data
    if any(np.any(getattr(m, field)[a]) for field in PASSIVE):
        return True
    if m.actuator_forcelimited[a] and not m.actuator_forcerange[a, 0] <= 0 <= m.actuator_forcerange[a, 1]:
        return True
    if m.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_NONE and np.any(m.actuator_biasprm[a]):
        return True
    fixed = m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    if fixed and m.actuator_gainprm[a, 0] == 0:
        return False
    if m.actuator_actadr[a] >= 0 or not (fixed or m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_AFFINE):
        return True
    its = slice(int(m.actuator_ctrladr[a]), int(m.actuator_ctrladr[a]) + int(m.actuator_ctrlnum[a]))
    return bool(np.any([_clipped(reading, a, control) for control in d.ctrl[its]]))


def _clipped(reading: Reading, a: int, control: float) -> float:
    m = reading.model
    its = int(m.actuator_ctrladr[a])
    if m.actuator_ctrllimited[its] and not off(m, "CLAMPCTRL"):
        return float(np.clip(control, *m.actuator_ctrlrange[its]))
    return float(control)


def _servo(reading: Reading, a: int, place: tuple[Table, int, float] | None, control: Control | None
           ) -> tuple[Table, tuple[str, str, float]] | None:
    """(an actuator with fixed gain and affine bias on a hinge or slide; its joint, what its control is there, and the
    factor of that); None for any other.

    Its force g0 u + b0 + b1 gear q + b2 gear q' is cut to its range and acts times the gear.
    """
    import mujoco

    m, d = reading.model, reading.data
    plain = (m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED and m.actuator_actadr[a] < 0
             and mujoco.mjtBias(m.actuator_biastype[a]) in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
             and m.actuator_ctrlnum[a] == 1 and not any(np.any(getattr(m, field)[a]) for field in PASSIVE))
    if not plain or place is None or not JOINT_TYPES[place[0]["type"]].has_one or "mimic" in place[0]:
        return None
    b0, b1, b2 = (m.actuator_biasprm[a, :3].tolist() if m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE else
                  [0.0] * 3)
    if b1 > 0 or b2 > 0:
        return None
    table, _, sign = place
    gear, gain = sign * float(m.actuator_gear[a, 0]), float(m.actuator_gainprm[a, 0])
    given = float(d.ctrl[int(m.actuator_ctrladr[a])]) if control is None else control
    u = scaled(given, 1.0) if isinstance(given, dict) else _clipped(reading, a, float(given))
    if isinstance(u, dict):
        _within(reading, a, u)
    made: Table = {"type": "servo", "joint": table["name"]}
    stiffness, damping = -b1 * gear**2, -b2 * gear**2
    key, factor = "effort", gear * gain
    if stiffness:
        key, factor = "target", gain / (-b1 * gear)
        made |= {key: scaled(u, factor), "target_velocity": 0.0, "proportional": stiffness}
    elif damping and gain:
        key, factor = "target_velocity", gain / (-b2 * gear)
        made |= {key: scaled(u, factor)}
    elif gain and u != 0.0:
        made |= {"feedforward": scaled(u, factor)}
    made |= {"derivative": damping} if damping else {}
    if b0:
        if isinstance(made.get("feedforward"), dict):
            return None
        made["feedforward"] = made.get("feedforward", 0.0) + gear * b0
    if m.actuator_forcelimited[a]:
        lower, upper = sorted(gear * m.actuator_forcerange[a])
        made["effort_limit"] = [float(lower), float(upper)]
    return made, (table["name"], key, factor)


def _clamp(reading: Reading, j: int, place: tuple[Table, int, float] | None, laws: Laws, count: int) -> None:
    """Cut what a single servo gives to the range of the actuator force on its joint; otherwise that is lost."""
    m = reading.model
    mine = LeftOut(label(m, j), "range of the actuator force on joint", tuple(m.jnt_actfrcrange[j].tolist()))
    if count != 1 or place is None:
        reading.lost.append(mine)
        return
    servo = next(force for force in laws.forces if force["joint"] == place[0]["name"])
    lower, upper = sorted(place[2] * m.jnt_actfrcrange[j])
    first, last = servo.get("effort_limit", [-np.inf, np.inf])
    ends = [float(np.clip(first, lower, upper)), float(np.clip(last, lower, upper))]
    if ends[0] >= ends[1]:
        reading.lost.append(mine)
        return
    servo["effort_limit"] = ends


def joint_of(m: Any, a: int) -> int:
    """The joint that an actuator acts on, -1 for none."""
    return int(m.actuator_trnid[a, 0]) if int(m.actuator_trntype[a]) in (0, 1) else -1


def controlled(m: Any, d: Any, wants: Wants) -> Wants:
    """The same with controls by the numbers of their actuators, for which `d` has their values at the start."""
    controls = {}
    for name, control in wants.controls.items():
        named = [a for a in range(m.nactuator) if m.actuator(a).name == name] or [
            a for a in range(m.nactuator) if joint_of(m, a) >= 0 and m.jnt(joint_of(m, a)).name == name]
        if not named:
            known = [m.actuator(a).name for a in range(m.nactuator) if m.actuator(a).name]
            raise ArgumentError(unknown("controls", name, known) if known else
                                f"controls: no actuator is named {name!r}, nor its joint")
        controls[named[0]] = control
        d.ctrl[int(m.actuator_ctrladr[named[0]])] = at_start(name, control)
    return dataclasses.replace(wants, controls=controls)


def at_start(name: str, control: Any) -> float:
    """A control at t = 0; raises `ArgumentError` that names it if it is none."""
    from crosscheck.scene.joint_options import function
    from crosscheck.scene.schema import EntryError, FunctionEntry

    try:
        if isinstance(control, dict):
            return float(function("", msgspec.convert(control, FunctionEntry, strict=True), 0.0)(0.0))
        number = float(control)
        if np.isfinite(number):
            return number
    except (TypeError, ValueError, EntryError, msgspec.ValidationError):
        pass
    raise ArgumentError(f"controls: that of {name!r} is neither a finite number nor the table of a function of time, "
                        'such as {"type": "sine", "terms": [[0.5, 3.0, 0.0]]}')


def scaled(control: Control, factor: float) -> Control:
    """A number or the table of a function of time, times a factor."""
    if not isinstance(control, dict):
        return float(control) * factor
    made = dict(control)
    for key in ("coefficients", "values"):
        if key in made:
            made[key] = [factor * value for value in made[key]]
    if "terms" in made:
        made["terms"] = [[factor * row[0], *row[1:]] for row in made["terms"]]
    if "offset" in made:
        made["offset"] = factor * made["offset"]
    return made


def _within(reading: Reading, a: int, control: Table) -> None:
    """Raise if a control that depends on time may leave the range in which MuJoCo would clip it."""
    m = reading.model
    its = int(m.actuator_ctrladr[a])
    if not m.actuator_ctrllimited[its] or off(m, "CLAMPCTRL"):
        return
    if control.get("type") == "sine":
        size, middle = sum(abs(row[0]) for row in control["terms"]), control.get("offset", 0.0)
        ends = middle - size, middle + size
    elif control.get("type") in ("hold", "linear"):
        ends = min(control["values"]), max(control["values"])
    else:
        raise ArgumentError(f"controls: {m.actuator(a).name!r} clips its control; give a number, or a sine, hold or "
                            "linear function, whose range is known")
    lower, upper = m.actuator_ctrlrange[its]
    if ends[0] < lower or ends[1] > upper:
        raise ArgumentError(f"controls: that of {m.actuator(a).name!r} reaches from {ends[0]:g} to {ends[1]:g}, beyond "
                            f"its range {lower:g} to {upper:g}, where MuJoCo clips it; give a smaller one")


def colliding(reading: Reading) -> list[tuple[int, int, float]]:
    """(geom, geom, margin) of the pairs between which MuJoCo would look for contacts that push."""
    m = reading.model
    if off(m, "CONTACT", "CONSTRAINT"):
        return []
    weld, types, affinities, bodies = reading.groups, m.geom_contype, m.geom_conaffinity, m.geom_bodyid
    kinds = m.geom_type
    parents = weld[m.body_parentid]
    groups = weld[bodies]
    excluded = {(int(code) >> 16, int(code) & 0xFFFF) for code in m.exclude_signature}
    excluded |= {pair[::-1] for pair in excluded}
    margins: dict[tuple[int, int], float] = {}
    some = np.flatnonzero((types != 0) | (affinities != 0))
    for i, a in enumerate(some.tolist()):
        others = some[i + 1:]
        own, theirs = groups[a], groups[others]
        meet = (own != theirs) & ((types[a] & affinities[others]) | (types[others] & affinities[a]) != 0)
        meet &= (kinds[a] != PLANE) | (kinds[others] != PLANE)
        if not off(m, "FILTERPARENT"):
            free = np.zeros(len(others), bool) if reading.urdf else (own == 0) | (theirs == 0)
            meet &= free | ((own != parents[theirs]) & (theirs != parents[own]))
        margins |= {(a, b): float(m.geom_margin[a] + m.geom_margin[b]) for b in others[meet].tolist()
                  if (int(bodies[a]), int(bodies[b])) not in excluded}
    for a, b, margin in zip(m.pair_geom1.tolist(), m.pair_geom2.tolist(), m.pair_margin.tolist(), strict=True):
        margins[min(a, b), max(a, b)] = float(margin)
    return [(a, b, margin) for (a, b), margin in margins.items()]


def clear(reading: Reading) -> bool:
    """Whether no two shapes that may collide touch in this state, as far as their distances are known."""
    solids, pairs = _Solids(reading), colliding(reading) if touching.available() else []
    return all((gap := solids.distance(a, b)) is None or gap >= margin for a, b, margin in pairs)


def _contacts(reading: Reading, wants: Wants, laws: Laws) -> None:
    """Shapes and monitors for the pairs that may collide; those that touch at the start are lost, of a URDF noted."""
    pairs, lost = colliding(reading), reading.noted if reading.urdf else reading.lost
    if wants.contacts == "monitor" and pairs and not touching.available():
        lost.append(LeftOut("", "contacts of the shapes that may collide",
                            "coal, which watches them, comes with pin and is not installed (pip install pin)"))
        return
    if len(pairs) > MOST_PAIRS:
        (reading.noted if wants.contacts == "drop" else lost).append(
            LeftOut("", f"contacts of the {len(pairs)} pairs of shapes that may collide", f"more than {MOST_PAIRS}"))
        return
    if wants.contacts == "drop":
        reading.noted += list(dict.fromkeys(LeftOut(_bodies(reading, a, b), "contacts of the colliding bodies")
                                            for a, b, _ in pairs))
        return
    if reading.urdf and len(set(reading.model.geom_bodyid.tolist())) > 1:
        reading.noted.append(LeftOut("", "contacts of links that share a joint"))
    solids, watched = _Solids(reading), []
    for a, b, margin in pairs:
        gap, mine = solids.distance(a, b), LeftOut(_bodies(reading, a, b), "contacts of the colliding bodies")
        if gap is None:
            lost.append(mine)
        elif gap < margin:
            lost.append(mine._replace(value="which touch at the start"))
        else:
            watched.append((a, b, margin))
    shapes = {g: solids.tables[g] for a, b, _ in watched for g in (a, b)}
    laws.shapes += distinct(list(shapes.values()))
    laws.monitors += [{"type": "touch", "shapes": [shapes[a]["name"], shapes[b]["name"]], "margin": margin}
                       for a, b, margin in watched]


class _Solids:
    """The geometries of a model as shapes of a scene, and their distances in the state of its data."""

    def __init__(self, reading: Reading) -> None:
        self._reading = reading
        self.tables: dict[int, Any] = {}  # entries of a scene file by their numbers; None: no shape has this form
        self._placed: dict[int, tuple[Any, np.ndarray, np.ndarray]] = {}

    def distance(self, a: int, b: int) -> float | None:
        """m, of two geometries, negative where they overlap; None for one that is no shape of a scene."""
        for g in {a, b} - self.tables.keys():
            table = self.tables[g] = _shape(self._reading, g)
            if table is not None:
                d = self._reading.data
                self._placed[g] = (touching.solid(table["type"], table.get("size"), table.get("points", ())),
                                   d.geom_xpos[g], d.geom_xmat[g].reshape(3, 3))
        if None in (self.tables[a], self.tables[b]):
            return None
        return touching.distance(self._placed[a], self._placed[b])


def _bodies(reading: Reading, a: int, b: int) -> str:
    m = reading.model
    ids = [int(m.geom_bodyid[each]) for each in (a, b)]
    return " - ".join(body_label(m, int(reading.groups[body]) or body) for body in ids)  # of what is welded, the root


def _shape(reading: Reading, g: int) -> Table | None:
    """A geometry as a shape; None for a height field or a distance field."""
    import mujoco
    from scipy.spatial import ConvexHull, QhullError

    m, d = reading.model, reading.data
    kind = mujoco.mjtGeom(m.geom_type[g]).name.removeprefix("mjGEOM_").lower()
    count = {"plane": 0, "sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3, "mesh": 0}.get(kind)
    if count is None:
        return None
    group = int(reading.groups[m.geom_bodyid[g]])
    body, position = reading.end(group, d.geom_xpos[g])
    attitude = quaternion_from_rotation(reading.attitude(group).T @ d.geom_xmat[g].reshape(3, 3))
    made: Table = {"name": m.geom(g).name or f"{body} {kind}", "body": body, "type": kind, "position": position,
                   "attitude": attitude.tolist()}
    if kind == "mesh":
        mesh = int(m.geom_dataid[g])
        points = m.mesh_vert[m.mesh_vertadr[mesh]:m.mesh_vertadr[mesh] + m.mesh_vertnum[mesh]].astype(float)
        try:
            points = points[ConvexHull(points).vertices]
        except (QhullError, ValueError):
            return None
        made["points"] = points.tolist()
    elif count:
        made["size"] = m.geom_size[g, :count].tolist()
    return made


def draw(m: Any, d: Any, seed: int) -> None:
    """Put the joints of `d` at a seeded random start, inside their limits, in place."""
    rng = np.random.default_rng(seed)
    for j in range(m.njnt):
        at, dof, kind = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j]), int(m.jnt_type[j])
        if kind in (0, 1):
            turn = rng.normal(size=4)
            start = at + (3 if kind == 0 else 0)
            d.qpos[start:start + 4] = turn / np.linalg.norm(turn)
            d.qvel[dof:dof + (6 if kind == 0 else 3)] = rng.normal(size=6 if kind == 0 else 3)
            continue
        reach = np.pi if kind == 3 else 0.1
        lower, upper = m.jnt_range[j] if m.jnt_limited[j] else (m.qpos0[at] - reach, m.qpos0[at] + reach)
        middle, half = (lower + upper) / 2, min((upper - lower) / 2, 1e3)
        d.qpos[at] = middle + 0.9 * half * rng.uniform(-1.0, 1.0)
        d.qvel[dof] = rng.normal()
