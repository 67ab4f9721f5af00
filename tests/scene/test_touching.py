"""Distances of shapes against MuJoCo's, and touches against closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck.scene import touching
from crosscheck.scene.building import scene_from
from crosscheck.scene.laws import SIZES

pytest.importorskip("coal")

POSES, MODELS = 10_000, 5

PAIRS = [pair for pair in itertools.combinations_with_replacement(SIZES, 2) if pair != ("plane", "plane")]

ALIKE = 1e-6
"""m. MuJoCo keeps the corners of meshes in single precision, 6e-8 of their size."""


def _model(mujoco, shapes):
    spec = mujoco.MjSpec()
    for k, (kind, size, points) in enumerate(shapes):
        body = spec.worldbody.add_body(mocap=True)
        geom = {"type": getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"), "size": [*size, 1, 1, 1][:3]}
        if kind == "mesh":
            geom["meshname"] = spec.add_mesh(name=f"mesh {k}", uservert=points.ravel()).name
        body.add_geom(**geom)
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-12, 1000
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_distances_are_mujocos(kinds):
    """Where they are apart to ALIKE, and on the same side wherever the gap is larger than that."""
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(PAIRS.index(kinds))
    apart = 0
    for _ in range(MODELS):
        shapes = [(kind, rng.uniform(0.05, 0.5, len(SIZES[kind])).tolist(), rng.normal(0.0, 0.3, (20, 3)))
                  for kind in kinds]
        solids = [touching.solid(*shape) for shape in shapes]
        model, data = _model(mujoco, shapes)
        for _ in range(-(-POSES // (MODELS * len(PAIRS)))):
            x, turns = rng.normal(0.0, rng.choice([0.3, 0.6]), (2, 3)), Rotation.random(2, rng=rng)
            data.mocap_pos[:], data.mocap_quat[:] = x, turns.as_quat(scalar_first=True)
            mujoco.mj_kinematics(model, data)
            theirs = mujoco.mj_geomDistance(model, data, 0, 1, 1e3, None)
            ours = touching.distance(*zip(solids, x, turns.as_matrix(), strict=True))
            if max(ours, theirs) > 0:
                apart += 1
                assert ours == pytest.approx(theirs, abs=ALIKE)
            elif max(abs(ours), abs(theirs)) > ALIKE:
                assert (ours < 0) == (theirs < 0)
    assert apart > 0.1 * POSES / len(PAIRS)


@pytest.mark.parametrize("kind", ["cylinder", "box", "ellipsoid", "capsule", "mesh"])
def test_a_touch_is_located_to_a_nanosecond(kind):
    """Of a shape that turns at a constant rate above a plane, whose lowest point is known."""
    pytest.importorskip("heyoka")
    height, rate, (a, b, c) = 0.5, 1.7, (0.2, 0.3, 0.6)
    corners = [[x, y, z] for x in (-a, a) for y in (-b, b) for z in (-c, c)]
    size = {"cylinder": [a, c], "box": [a, b, c], "ellipsoid": [a, b, c], "capsule": [a, c - a], "mesh": []}[kind]

    def lowest(t: float) -> float:
        s, d = abs(np.sin(rate * t)), abs(np.cos(rate * t))  # it begins with its longest axis level
        return {"cylinder": c * s + a * d, "ellipsoid": np.hypot(c * s, a * d), "capsule": (c - a) * s + a}.get(
            kind, c * s + a * d)

    solid = {"points": corners} if kind == "mesh" else {"size": size}
    scene = scene_from({
        "schema": 3, "name": "stick", "gravity": [0.0, 0.0, 0.0], "duration": 1.0, "samples": 11,
        "bodies": [{"name": "stick", "mass": 1.0, "inertia": (0.1 * np.eye(3)).tolist(), "position": [0.0, 0.0, height],
                    "attitude": [0.5**0.5, 0.0, 0.5**0.5, 0.0], "angular_velocity": [0.0, rate, 0.0]}],
        "shapes": [{"name": "floor", "body": "ground", "type": "plane"},
                   {"name": "solid", "body": "stick", "type": kind, **solid}],
        "monitors": [{"type": "touch", "shapes": ["solid", "floor"]}]}, "stick.toml")
    exact = brentq(lambda t: lowest(t) - height, 0.0, 0.8, xtol=1e-14)
    assert crosscheck.truth(scene).horizon == pytest.approx(exact, abs=1e-9)


def test_balls_around_shapes_are_never_closer_than_the_shapes():
    rng = np.random.default_rng(0)
    kinds = [kind for kind in SIZES if kind != "plane"]
    body = {"mass": 1.0, "inertia": np.eye(3).tolist()}
    shapes = [{"name": kind, "body": f"b{k}", "type": kind, "position": rng.normal(size=3).tolist(),
               **({"points": rng.normal(size=(9, 3)).tolist()} if kind == "mesh" else
                  {"size": rng.uniform(0.1, 1.0, len(SIZES[kind])).tolist()})} for k, kind in enumerate(kinds)]
    scene = scene_from({
        "schema": 3, "name": "apart", "gravity": [0.0, 0.0, 0.0], "duration": 1.0, "samples": 2, "shapes": shapes,
        "bodies": [body | {"name": f"b{k}", "position": [100.0 * k, 0.0, 0.0]} for k in range(len(kinds))],
        "monitors": [{"type": "touch", "shapes": list(pair)} for pair in itertools.combinations(kinds, 2)]},
        "apart.toml")
    watched = touching.Touching(scene)
    x = rng.normal(0.0, 2.0, (20, scene.n, 3))
    R = np.array([Rotation.random(scene.n, rng=rng).as_matrix() for _ in x])
    gaps = np.array([watched.gaps(*pose) for pose in zip(x, R, strict=True)])
    assert np.all(watched.below(x, R)[gaps > 0] <= gaps[gaps > 0] + touching.TOLERANCE)
