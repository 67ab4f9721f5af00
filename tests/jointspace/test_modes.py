"""Modes against published eigenvalues and closed forms."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.cli.linear_pages import _branches, _drawn
from crosscheck.errors import ArgumentError
from crosscheck.jointspace.modes import at_speed
from crosscheck.scene.building import scene_from
from crosscheck.scene.paths import unit

# doi:10.1098/rspa.2007.1857, table 2: weave (two real values at rest), capsize, castering; speed in m/s
BICYCLE = {
    0: (5.53094371765393, 3.13164324790656, -3.13164324790656, -5.53094371765393),
    1: (3.52696170990070 + 0.80774027519930j, -3.13423125066578, -7.11008014637442),
    2: (2.68234517512745 + 1.68066296590675j, -3.07158645641514, -8.67387984831735),
    3: (1.70675605663975 + 2.31582447384325j, -2.63366137253667, -10.35101467245920),
    4: (0.41325331521125 + 3.07910818603206j, -1.42944427361326, -12.15861426576447),
    5: (-0.77534188219585 + 4.46486771378823j, -0.32286642900409, -14.07838969279822),
    6: (-1.52644486584142 + 5.87673060598709j, -0.00406690076970, -16.08537123098026),
    7: (-2.13875644258362 + 7.19525913329805j, 0.10268170574766, -18.15788466125262),
    8: (-2.69348683581097 + 8.46037971396931j, 0.14327879765713, -20.27940894394569),
    9: (-3.21675402252485 + 9.69377351531791j, 0.15790184030917, -22.43788559040858),
    10: (-3.72016840437287 + 10.90681139476287j, 0.16105338653172, -24.62459635017404),
}


@pytest.mark.parametrize("speed", BICYCLE)
def test_the_published_bicycle(speed):
    values = crosscheck.modes(at_speed(crosscheck.load_scene("bicycle"), float(speed))).eigenvalues
    assert np.count_nonzero(values == 0) == 6  # place, heading, two wheels and the speed, which is one more link
    for wanted in BICYCLE[speed]:
        assert np.abs(values - wanted).min() < 1e-12


@pytest.mark.parametrize(("near", "wanted", "pick"), [
    (4.3, 4.29238253634111, lambda values: values[np.argmax(values.imag)].real),
    (6.02, 6.02426201538837, lambda values: max(values.real[(values.imag == 0) & (values != 0)]))])
def test_weave_and_capsize_speeds(near, wanted, pick):
    scene, away = crosscheck.load_scene("bicycle"), 0.1 * np.cos(np.pi * (2 * np.arange(12) + 1) / 24)  # Chebyshev
    growth = [pick(crosscheck.modes(at_speed(scene, near + each)).eigenvalues) for each in away]
    roots = np.polynomial.Chebyshev.fit(away, growth, 11).roots()
    assert near + min(roots.real, key=abs) == pytest.approx(wanted, abs=1e-11)


def described(angle, spin=0.0, moments=(0.2, 0.2, 0.05), gravity=9.81):
    """A body on a ball joint .5 m above its mass centre, or below it if the angle is pi."""
    return {
        "schema": 2, "name": "hung", "gravity": [0.0, 0.0, -gravity], "duration": 1.0, "samples": 11,
        "bodies": [{"name": "body", "mass": 2.0, "inertia": np.diag(moments).tolist(),
                    "attitude": [float(np.cos(angle / 2)), float(np.sin(angle / 2)), 0.0, 0.0],
                    "angular_velocity": [0.0, 0.0, spin]}],
        "joints": [{"name": "ball", "type": "spherical", "parent": "ground", "child": "body",
                    "parent_anchor": [0.0, 0.0, 0.0], "child_anchor": [0.0, 0.0, 0.5]}]}


def hung(angle, spin=0.0):
    return scene_from(described(angle, spin), "hung")


def test_a_hanging_body_swings_at_its_frequency():
    values = crosscheck.modes(hung(0.0)).eigenvalues
    swing = np.sqrt(2.0 * 9.81 * 0.5 / (0.2 + 2.0 * 0.25))
    np.testing.assert_allclose(sorted(values.imag), [-swing, -swing, 0.0, 0.0, swing, swing], atol=1e-13)
    np.testing.assert_allclose(values.real, 0.0, atol=1e-13)


@pytest.mark.parametrize("spin", [10.0, 80.0])
def test_a_sleeping_top_in_axes_that_do_not_spin(spin):
    values = crosscheck.modes(hung(np.pi, spin)).eigenvalues
    across, along = 0.2 + 2.0 * 0.25, 0.05
    roots = np.roots([across, -1j * along * -spin, -2.0 * 9.81 * 0.5])  # the spin points down, with the body's axis
    for wanted in (*roots, *roots.conj()):
        assert np.abs(values - wanted).min() < 1e-12
    assert len(values) == 6


def test_a_precessing_top():
    # Lagrange's top in steady precession Omega at the angle tilt, with p the whole spin along its axis:
    # across cos(tilt) Omega^2 - along p Omega + m g l = 0. Nutation about it (small changes of the angle) has
    # across^2 nu^2 = (along p)^2 - 4 across m g l cos(tilt) + (m g l)^2 ... , which follows here from the effective
    # potential of the angle by differences.
    across, along, tilt, spin, weight = 0.2 + 0.5, 0.05, np.pi / 3, 300.0, 9.81
    rate = (along * spin - np.sqrt((along * spin) ** 2 - 4 * across * np.cos(tilt) * weight)) / (
        2 * across * np.cos(tilt))
    vertical = across * rate * np.sin(tilt) ** 2 + along * spin * np.cos(tilt)  # both momenta are kept

    def potential(angle):
        return ((vertical - along * spin * np.cos(angle)) ** 2 / (2 * across * np.sin(angle) ** 2)
                + weight * np.cos(angle))

    h = 1e-3
    stiffness = (-potential(tilt + 2 * h) + 16 * potential(tilt + h) - 30 * potential(tilt) + 16 * potential(tilt - h)
                 - potential(tilt - 2 * h)) / (12 * h**2)
    top = hung(np.pi - tilt)
    R, e = top.R0[0], np.array([0.0, 0.0, -1.0])  # e: from the joint to the mass centre
    w = rate * R.T @ [0.0, 0.0, 1.0] + (spin - rate * np.cos(tilt)) * e
    moving = dataclasses.replace(top.bodies[0], angular_velocity=w, velocity=R @ np.cross(w, 0.5 * e))
    values = crosscheck.modes(top.replace(bodies=(moving,))).eigenvalues
    assert np.abs(values.real).max() < 1e-9
    assert np.abs(values.imag).max() == pytest.approx(np.sqrt(stiffness / across), rel=1e-6)


@pytest.mark.parametrize(("scene", "said"), [
    ("double_pendulum", "no steady motion"), ("hinge_pendulum", "neither an equilibrium nor a steady motion"),
    ("driven_cart", "depend on time"), ("rod_pendulum", "no joint coordinates")])
def test_other_motions_are_refused(scene, said):
    with pytest.raises(crosscheck.Unsupported, match=said):
        crosscheck.modes(scene)


def test_shapes_are_eigenvectors_on_the_bodies():
    found = crosscheck.modes(hung(0.0))
    assert found.shapes.shape == (6, 6)
    for k in range(6):
        x, turn = found.shapes[:3, k], found.shapes[3:, k]
        np.testing.assert_allclose(x, -np.cross(turn, [0.0, 0.0, 0.5]), atol=1e-12)  # about the joint


def test_the_command_over_speed():
    answer = CliRunner().invoke(app, ["linearise", "bicycle", "--over", "speed=4:6", "--points", "3", "--json"])
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.output)["eigenvalues"]
    assert list(told) == ["4", "5", "6"]
    assert min(abs(complex(*value) - BICYCLE[5][0]) for value in told["5"]) < 1e-12
    answer = CliRunner().invoke(app, ["linearise", "--modes", "bicycle"])
    assert "-0.7753418821958" in answer.output
    assert "6 of zero" in answer.output
    for wrong in ("speed", "speed=1", "weight=1:2", "speed=nan:1", "speed=0:inf", "speed=1e200:1e300"):
        refused = CliRunner().invoke(app, ["linearise", "bicycle", "--over", wrong, "--points", "2"]).exception
        assert isinstance(refused, ArgumentError), wrong


def test_the_page_has_eigenvalues_with_units_and_shapes_in_motion(tmp_path):
    file = tmp_path / "hung.json"
    file.write_text(json.dumps(described(0.0)), "utf-8")
    answer = CliRunner().invoke(app, ["linearise", str(file), "--over", "bodies.body.mass=1:3", "--points", "3",
                                      "--out", str(tmp_path / "page")])
    assert answer.exit_code == 0, answer.output
    assert "bodies.body.mass = 2 kg: " in answer.output
    text = (tmp_path / "page/index.html").read_text("utf-8")
    told = json.loads(text.partition('id="found">')[2].partition("</script>")[0])
    assert told["curves"]["label"] == "bodies body mass (kg)"
    swings = [trace for trace in told["curves"]["traces"] if trace["name"] == "angular frequency"]
    for k, mass in enumerate((1.0, 2.0, 3.0)):
        wanted = np.sqrt(mass * 9.81 * 0.5 / (0.2 + mass * 0.25))
        assert all(trace["y"][k] == pytest.approx(wanted, rel=1e-12) for trace in swings)
        assert all(trace["x"][k] == mass for trace in swings)
    assert len(swings) == 2
    assert len(told["drawn"]["actors"]) == 3  # two swings and the start
    assert (tmp_path / "page/playback.js").exists()


def test_shapes_move_as_their_eigenvalues_say_with_joints_closed():
    scene = crosscheck.load_scene("bicycle")
    found = crosscheck.modes(scene)
    kept = [k for k, value in enumerate(found.eigenvalues) if value.imag > 0]
    drawn = _drawn(scene, found, kept)
    t, moved = np.array(drawn["t"]), np.array(drawn["actors"][0]["x"]) - scene.x0[:, :, None]
    assert t[-1] == pytest.approx(4 * np.pi / found.eigenvalues[kept[0]].imag)
    shape = found.shapes[:, kept[0]].reshape(-1, 6)[:, :3]
    wanted = np.real(shape[..., None] * np.exp(found.eigenvalues[kept[0]] * t))
    wanted *= np.sum(wanted * moved) / np.sum(wanted**2)
    assert np.abs(moved - wanted).max() < 0.15 * np.abs(wanted).max()  # the square of 0.3 rad
    assert json.loads(json.dumps(drawn)) == drawn


def test_eigenvalues_that_cross_keep_their_curves():
    rows = {k: np.sort([k - 2.0, 2.0 - k, 0.0]).astype(complex) for k in (0.0, 1.5, 3.0)}
    curves = _branches("gravity.2", rows)
    assert curves["label"] == "gravity 2 (m/s²)"
    assert sorted(trace["y"] for trace in curves["traces"]) == [[-2.0, -0.5, 1.0], [2.0, 0.5, -1.0]]


@pytest.mark.parametrize(("path", "wanted"), [("speed", "m/s"), ("bodies.b.inertia.0.0", "kg m²"),
                                              ("forces.0.stiffness", ""), ("joints.j.child_anchor.2", "m")])
def test_units_of_numbers(path, wanted):
    assert unit(path) == wanted
