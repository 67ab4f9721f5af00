"""Accelerations of a tree in minimal coordinates by block elimination, leaves first, over any number type.

Derivation. To give a body, with everything attached on its outer side, the angular acceleration alpha and the
acceleration A of its reference point takes the torque N and the force F at that point, in the body's axes,

    N = I alpha + K A + tau,    F = K^T alpha + M A + f.

For the body alone, with lever r to the centre of mass and r^ = hat(r): I = J - m r^ r^, K = m r^, M = m,
f = m (w x (w x r) - g) - applied force, tau = w x J w + r x f - applied torque. An outer body at arm l, in this body's
axes, moves with A + alpha x l: it adds I - K l^ - (K l^)^T - l^ M l^, K + l^ M, M.

A joint transmits no power along its motions: S^T (N, F) = 0 for (alpha, A) = carried along + S du + bias. This gives du
and reduces the six by six H = (I, K; K^T, M) to H - H S (S^T H S)^-1 S^T H. A free turn is eliminated first, by itself,
because its angular acceleration does not depend on the inner body. A rod transmits only a force along itself: F = phi e
with e . A prescribed, which reduces H to e e^T / (e . M^-1 e).

Applied wrenches come in columns: the first is the actual one; each further one belongs to a unit multiplier of a loop,
without velocities and weight.
"""

from __future__ import annotations

import dataclasses

from crosscheck.references.generic import (
    ByBody,
    Matrix,
    Number,
    Vector,
    add,
    apply,
    apply_transposed,
    combine,
    congruent,
    cross,
    dot,
    factor_symmetric,
    hat,
    multiply,
    outer,
    rotation,
    scale,
    solve_factored,
    transpose,
)
from crosscheck.references.joint_motion import ZERO, Frame, Tree
from crosscheck.references.tree import FREE, Link
from crosscheck.scene.model import GROUND

NONE = [ZERO, ZERO, ZERO]


def gyroscopic(inertia: Matrix, w: Vector) -> Vector:
    """w x J w, body axes.

    Computed as w x (J - s) w, with s the middle entry on the diagonal: two equal moments then cancel exactly. Their
    rounding error would spin up a needle, whose third moment is a millionth of theirs. Symbols have no order, and s is
    the first.
    """
    diagonal = [inertia[k][k] for k in range(3)]
    middle = sorted(diagonal)[1] if all(isinstance(entry, float) for entry in diagonal) else diagonal[0]
    return cross(w, apply([[entry - middle if i == j else entry for j, entry in enumerate(row)]
                           for i, row in enumerate(inertia)], w))


def centripetal(w: Vector, lever: Vector) -> Vector:
    """w x (w x lever), body axes."""
    return cross(w, cross(w, lever))


def weight(mass: float, gravity: Vector) -> Vector:
    """m g in the axes of `gravity`."""
    return scale(mass, gravity)


@dataclasses.dataclass
class Answer:
    """I, K, M and the (tau, f) of each column, at the reference point of a body."""

    inertia: Vector
    coupling: Vector
    mass: Vector
    columns: Vector

    def times(self, alpha: Vector, A: Vector) -> tuple[Vector, Vector]:
        """H (alpha, A)."""
        return (add(apply(self.inertia, alpha), apply(self.coupling, A)),
                add(apply_transposed(self.coupling, alpha), apply(self.mass, A)))


@dataclasses.dataclass
class Eliminated:
    """The elimination of a joint's motions: du = -rest - Z^T (alpha, A), and the motions with their bias."""

    motions: Vector
    bias: tuple[Number, ...]
    Z: Vector
    rest: Vector

    def forward(self, column: int, alpha: Vector, A: Vector) -> tuple[Vector, Vector, Vector]:
        """du, and the accelerations of the outer body from those carried along."""
        du = [-(dot(turn, alpha) + dot(shift, A)) - rest
              for (turn, shift), rest in zip(self.Z, self.rest[column], strict=True)]
        if column == 0:
            alpha, A = add(alpha, self.bias[0]), add(A, self.bias[1])
        for rate, (turn, shift) in zip(du, self.motions, strict=True):
            alpha, A = add(alpha, scale(rate, turn)), add(A, scale(rate, shift))
        return du, alpha, A


@dataclasses.dataclass
class Rod:
    """The elimination of a rod, F = phi e, or of a free body, F = 0 (then without e)."""

    factors: tuple[Number, ...]
    columns: Vector
    e: Vector | None = None
    stiffness: object = 0.0  # 1 / (e . M^-1 e)
    loads: Vector = dataclasses.field(default_factory=list)  # phi at carried acceleration zero

    def forward(self, column: int, alpha: Vector, A: Vector) -> Vector:
        """The acceleration of the reference point from that carried along; `alpha` is not used."""
        force = scale(-1.0, self.columns[column][1])
        if self.e is not None:
            force = add(force, scale(self.stiffness * dot(self.e, A) + self.loads[column], self.e))
        return solve_factored(self.factors, force)


@dataclasses.dataclass
class Prescribed:
    """A joint whose speed has a given derivative: it adds that and its bias to the accelerations carried along."""

    rate: Number
    alpha: Vector
    A: Vector

    def forward(self, column: int, alpha: Vector, A: Vector) -> tuple[Vector, Vector, Vector]:
        """du, and the accelerations of the outer body from those carried along."""
        return ([self.rate], add(alpha, self.alpha), add(A, self.A)) if column == 0 else ([0.0], alpha, A)


def accelerations(tree: Tree, frames: dict[int, Frame], wrenches: ByBody, efforts: ByBody | None = None,
                  driven: dict[int, Number] | None = None) -> tuple[ByBody, ByBody, ByBody]:
    """alpha, A and derivatives of speeds; each maps bodies to a list over columns.

    `wrenches` maps bodies, without the ground, to columns of (force, torque about the centre of mass) in own axes;
    `efforts` maps them to columns of generalized forces along each angle and displacement of their joint; `driven` maps
    them to the second derivative of the joint's coordinate, if that is prescribed.
    """
    count = len(next(iter(wrenches.values())))
    gravity = _gravity(tree, frames)
    hanging: dict[int, list[Answer]] = {link.body: [] for link in tree.links}
    joints: ByBody = {}
    for link in reversed(tree.links):
        body, frame = link.body, frames[link.body]
        answer = _own(link, frame, gravity[body], wrenches[body])
        for part in hanging[body]:
            answer = _sum(answer, part)
        if driven and body in driven:
            joints[body], passed = _prescribed(frame, answer, driven[body])
        else:
            joints[body], passed = _through_joint(link, frame, answer, None if efforts is None else efforts[body])
        if link.parent != GROUND:
            hanging[link.parent].append(_carried(passed, frame, frames[link.parent], link))
    alpha = {GROUND: [ZERO] * count}
    A = {GROUND: [ZERO] * count}
    rates: ByBody = {}
    for link in tree.links:
        body = link.body
        results = [_outward(link, frames, joints[body], column, alpha[link.parent][column], A[link.parent][column])
                   for column in range(count)]
        alpha[body], A[body], rates[body] = (list(part) for part in zip(*results, strict=True))
    return alpha, A, rates


def _gravity(tree: Tree, frames: dict[int, Frame]) -> ByBody:
    """Gravity in the axes of every body."""
    gravity = {GROUND: tree.scene.gravity.tolist()}
    for link in tree.links:
        frame = frames[link.body]
        if link.turn == FREE:  # from the body's own quaternion; products along a chain would accumulate rounding
            gravity[link.body] = apply_transposed(rotation(frame.q), gravity[GROUND])
        else:
            gravity[link.body] = apply_transposed(frame.turn, gravity[link.parent])
    return gravity


def _own(link: Link, frame: Frame, gravity: Vector, wrenches: Vector) -> Answer:
    """I, K, M, tau and f of the body alone."""
    r = hat(frame.lever)
    mass = [[link.mass if i == j else 0.0 for j in range(3)] for i in range(3)]
    columns = []
    for k, (force, torque) in enumerate(wrenches):
        f, tau = scale(-1.0, force), scale(-1.0, torque)
        if k == 0:
            f = add(f, scale(link.mass, centripetal(frame.w, frame.lever)), scale(-1.0, weight(link.mass, gravity)))
            tau = add(tau, gyroscopic(link.inertia, frame.w))
        columns.append((add(tau, cross(frame.lever, f)), f))
    inertia = combine(link.inertia, -link.mass, multiply(r, r))
    return Answer(inertia, [scale(link.mass, row) for row in r], mass, columns)


def _sum(one: Answer, other: Answer) -> Answer:
    columns = [(add(tau, more_tau), add(f, more_f))
               for (tau, f), (more_tau, more_f) in zip(one.columns, other.columns, strict=True)]
    return Answer(combine(one.inertia, 1.0, other.inertia), combine(one.coupling, 1.0, other.coupling),
                  combine(one.mass, 1.0, other.mass), columns)


def _through_joint(link: Link, frame: Frame, answer: Answer, efforts: Vector | None) -> tuple[Vector, Answer]:
    """The stages of a joint in the order of their elimination, and the reduced answer at its point."""
    stages: Vector = []
    if link.turn == FREE:
        turn, answer = _free_turn(answer)
        stages.append(turn)
    if link.shift in ("sphere", "free"):
        rod, answer = _rod(link, frame, answer)
        stages.append(rod)
    elif frame.columns:
        armature = () if link.joint is None else link.joint.armature
        taken, answer = _eliminate(answer, frame.columns, (frame.spin_bias, frame.shift_bias), efforts, armature)
        stages.append(taken)
    return stages, answer


def _prescribed(frame: Frame, answer: Answer, rate: Number) -> tuple[Vector, Answer]:
    """The stage and the reduced answer of a joint whose coordinate has a given second derivative."""
    turn, shift = frame.columns[0]
    taken = Prescribed(rate, add(frame.spin_bias, scale(rate, turn)), add(frame.shift_bias, scale(rate, shift)))
    tau, f = answer.times(taken.alpha, taken.A)
    first = (add(answer.columns[0][0], tau), add(answer.columns[0][1], f))
    return [taken], Answer(answer.inertia, answer.coupling, answer.mass, [first, *answer.columns[1:]])


def _free_turn(answer: Answer) -> tuple[tuple[Number, ...], Answer]:
    """Eliminate a free turn: no torque at the reference point gives alpha = -(rest + coupling A)."""
    factors = factor_symmetric(answer.inertia)
    rest = [solve_factored(factors, tau) for tau, _ in answer.columns]
    solved = transpose([solve_factored(factors, column) for column in transpose(answer.coupling)])
    columns = [(ZERO, add(f, scale(-1.0, apply_transposed(answer.coupling, part))))
               for (_, f), part in zip(answer.columns, rest, strict=True)]
    mass = combine(answer.mass, -1.0, multiply(transpose(answer.coupling), solved))
    return (rest, solved), Answer(NONE, NONE, mass, columns)


def _eliminate(answer: Answer, motions: Vector, bias: tuple[Number, ...],
               efforts: Vector | None, armature: tuple[float, ...] = ()) -> tuple[Eliminated, Answer]:
    """Eliminate motions (angular, linear) of a joint; `bias` are the accelerations at constant speeds.

    `armature` is the rotor inertia of each motion.
    """
    Y = [answer.times(*motion) for motion in motions]
    matrix = [[dot(turn, y[0]) + dot(shift, y[1]) for y in Y] for turn, shift in motions]
    for k, rotor in enumerate(armature):
        matrix[k][k] = matrix[k][k] + rotor
    factors = factor_symmetric(matrix)
    Z: list[tuple[Vector, Vector]] = [([], []) for _ in motions]
    for part in range(2):
        for entries in zip(*(y[part] for y in Y), strict=True):
            for z, value in zip(Z, solve_factored(factors, list(entries)), strict=True):
                z[part].append(value)
    biased = answer.times(*bias)
    columns, rests = [], []
    for k, (tau, f) in enumerate(answer.columns):
        if k == 0:
            tau, f = add(tau, biased[0]), add(f, biased[1])
        power = [dot(turn, tau) + dot(shift, f) for turn, shift in motions]
        if efforts is not None:
            power = add(power, scale(-1.0, efforts[k]))
        rest = solve_factored(factors, power)
        rests.append(rest)
        for part, y in zip(rest, Y, strict=True):
            tau, f = add(tau, scale(-part, y[0])), add(f, scale(-part, y[1]))
        columns.append((tau, f))
    inertia, coupling, mass = answer.inertia, answer.coupling, answer.mass
    for y, z in zip(Y, Z, strict=True):
        inertia = combine(inertia, -1.0, outer(y[0], z[0]))
        coupling = combine(coupling, -1.0, outer(y[0], z[1]))
        mass = combine(mass, -1.0, outer(y[1], z[1]))
    return Eliminated(motions, bias, Z, rests), Answer(inertia, coupling, mass, columns)


def _rod(link: Link, frame: Frame, answer: Answer) -> tuple[Rod, Answer]:
    """Eliminate a rod or a free translation, after the free turn."""
    factors = factor_symmetric(answer.mass)
    if link.shift == "free":
        return Rod(factors, answer.columns), Answer(NONE, NONE, NONE, [(ZERO, ZERO) for _ in answer.columns])
    e = scale(1.0 / link.length, apply_transposed(frame.turn, frame.rod))
    solved = solve_factored(factors, e)
    stiffness = 1.0 / dot(e, solved)
    loads = [stiffness * dot(solved, f) for _, f in answer.columns]
    loads[0] = loads[0] - stiffness * dot(frame.shifting, frame.shifting) / link.length
    columns = [(ZERO, scale(load, e)) for load in loads]
    return (Rod(factors, answer.columns, e, stiffness, loads),
            Answer(NONE, NONE, outer(scale(stiffness, e), e), columns))


def _carried(passed: Answer, frame: Frame, inner: Frame, link: Link) -> Answer:
    """The answer in the inner body's axes, at its reference point."""
    inertia, mass = congruent(frame.turn, passed.inertia), congruent(frame.turn, passed.mass)
    coupling = multiply(multiply(frame.turn, passed.coupling), transpose(frame.turn))
    arm = hat(frame.arm)
    drag = _drag(link, frame, inner)
    drawn = (apply(coupling, drag), apply(mass, drag))
    columns = []
    for k, (tau, f) in enumerate(passed.columns):
        tau, f = apply(frame.turn, tau), apply(frame.turn, f)
        if k == 0:
            tau, f = add(tau, drawn[0]), add(f, drawn[1])
        columns.append((add(tau, cross(frame.arm, f)), f))
    twisted, moved = multiply(coupling, arm), multiply(arm, mass)
    inertia = combine(combine(inertia, -1.0, multiply(moved, arm)), -1.0,
                      combine(twisted, 1.0, transpose(twisted)))
    return Answer(inertia, combine(coupling, 1.0, moved), mass, columns)


def _drag(link: Link, frame: Frame, inner: Frame) -> Vector:
    """Acceleration of the joint's point at constant speeds, beyond the one carried along; inner axes."""
    drag = centripetal(inner.w, frame.arm)
    if link.outward or link.shift == "none":
        return drag
    return add(drag, scale(2.0, cross(inner.w, frame.shifting)))


def _outward(link: Link, frames: dict[int, Frame], stages: Vector, column: int, alpha: Vector,
             A: Vector) -> tuple[Vector, Vector, Vector]:
    """alpha, A and the derivatives of the speeds of a body from the accelerations of its inner one."""
    frame, inner = frames[link.body], frames[link.parent]
    at_joint = add(A, cross(alpha, frame.arm))
    if column == 0 and link.parent != GROUND:
        at_joint = add(at_joint, _drag(link, frame, inner))
    A = apply_transposed(frame.turn, at_joint)
    if link.turn != FREE:
        alpha = apply_transposed(frame.turn, alpha)
        if not stages:
            return alpha, A, []
        du, alpha, A = stages[0].forward(column, alpha, A)
        return alpha, A, du
    du = []
    if isinstance(stages[-1], Eliminated):
        du, _, A = stages[-1].forward(column, ZERO, A)
    elif isinstance(stages[-1], Rod):
        A = stages[-1].forward(column, alpha, A)
        du = scale(1.0 / link.length, add(apply(frame.turn, A), scale(-1.0, at_joint)))
    rest, coupling = stages[0]
    alpha = scale(-1.0, add(rest[column], apply(coupling, A)))
    return alpha, A, [*alpha, *du]
