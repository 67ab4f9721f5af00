"""Functions of time: their values and derivatives, their entries in files, and the work of loads."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import crosscheck
from crosscheck.scene import functions
from lieeuler import _kernel
from tests import saved

TABLE = ([0.0, 0.3, 1.0, 1.4, 2.0], [1.0, -2.0, 0.5, 3.0, -1.0])
KINDS = {
    "polynomial": functions.polynomial([1.0, -2.0, 0.0, 0.5]),
    "sine": functions.sine([(2.0, 3.0, 0.4), (-0.5, 11.0, 1.0)], 0.7),
    "spline": functions.spline(*TABLE),
    "linear": functions.linear([0.5, 1.0, 1.5], [1.0, -2.0, 0.5]), "hold": functions.hold([0.5, 1.0], [1.0, -2.0]),
    "mixed": functions.TimeFunction((0.0, 0.8), ((1.0, 2.0), (2.6, 2.0, -3.0)), ((0.3, 5.0, 0.1),)),
}
T = np.linspace(0.0, 2.0, 41)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_values(kind):
    f, step = KINDS[kind], 1e-6
    for order in range(3):
        inside = np.array([0.13, 0.71, 0.93, 1.7])  # away from breaks, where a derivative may jump
        slope = (f(inside + step, order) - f(inside - step, order)) / (2 * step)
        # central differences: eps / step times values of some ten, and step^2 times derivatives up to 11^5
        np.testing.assert_allclose(slope, f(inside, order + 1), rtol=0, atol=1e-6 * 11**order)


def test_a_spline_is_that_of_scipy():
    np.testing.assert_allclose(KINDS["spline"](T), CubicSpline(*TABLE)(T), rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_series_of_the_kernel_are_the_derivatives(kind):
    f = KINDS[kind]
    kernel = _kernel.TimeFunction(f.breaks, f.pieces, f.terms)
    for t in (0.0, 0.41, 0.8, 1.4, 1.9):
        wanted = [f(t, k) / np.prod(np.arange(1.0, k + 1)) for k in range(8)]
        size = max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(kernel.expand(t, 8), wanted, rtol=0, atol=1e-14 * size)


def test_tables_are_held_or_straight_between_their_times_and_constant_outside():
    t = np.array([0.0, 0.5, 0.75, 1.0, 1.25, 2.0])
    np.testing.assert_allclose(KINDS["linear"](t), np.interp(t, [0.5, 1.0, 1.5], [1.0, -2.0, 0.5]), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(KINDS["linear"](t, 1), [0.0, -6.0, -6.0, 5.0, 5.0, 0.0])  # slopes to the right
    np.testing.assert_array_equal(KINDS["hold"](t), [1.0, 1.0, 1.0, -2.0, -2.0, -2.0])
    np.testing.assert_array_equal(KINDS["hold"](t, 1), np.zeros(6))
    assert {kind for kind, function in KINDS.items() if function.jumps} == {"hold"}


def test_delay_and_factor():
    f = KINDS["mixed"]
    np.testing.assert_allclose(f.delayed(0.25)(T), f(T - 0.25), rtol=0, atol=1e-14)
    np.testing.assert_allclose(f.times(-3.0)(T), -3.0 * f(T), rtol=0, atol=1e-14)


SCENE = """schema = 2
name = "one"
gravity = [0.0, 0.0, -9.81]
duration = 1.0
samples = 3
[[bodies]]
name = "bar"
mass = 1.0
inertia = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
[[joints]]
name = "pin"
type = "revolute"
parent = "ground"
child = "bar"
parent_anchor = [0.0, 0.0, 0.0]
child_anchor = [0.0, 0.0, 0.5]
parent_axis = [0.0, 1.0, 0.0]
child_axis = [0.0, 1.0, 0.0]
[[forces]]
type = "joint_torque"
joint = "pin"
torque = VALUE
"""


@pytest.mark.parametrize(("text", "words"), [
    ('{ type = "polynomial", coefficients = [] }', ["torque: coefficients", "is empty"]),
    ('{ type = "sine", terms = [[1.0, 2.0]] }', ["terms"]),
    ('{ type = "sine", terms = [[1.0, 2.0, 0.0]], frequency = 3.0 }', ["frequency"]),
    ('{ type = "spline", times = [0.0, 1.0], values = [0.0] }', ["values", "1 given for 2 times"]),
    ('{ type = "spline", times = [0.0, 1.0, 0.5], values = [0.0, 1.0, 2.0] }', ["times", "do not increase"]),
    ('{ type = "spline", times = [0.0, 0.5], values = [0.0, 1.0] }', ["times", "cover the whole run"]),
    ('{ type = "steps", times = [0.0] }', ["torque"]),
    ("[1.0, 2.0, 3.0]", ["torque"]),
    ('{ type = "polynomial", coefficients = [inf] }', ["not a finite number"]),
])
def test_a_wrong_function_is_named(tmp_path, text, words):
    path = saved(tmp_path / "one.toml", SCENE.replace("VALUE", text))
    with pytest.raises(crosscheck.SceneError) as caught:
        crosscheck.load_scene(path)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in ["forces[0]", *words])


@pytest.mark.parametrize(("old", "new", "words"), [
    ("schema = 2", "schema = 1", ["is of version 2", "schema = 2"]),
    ('"pin"\ntorque', '"pun"\ntorque', ['no joint is named "pun"', 'did you mean "pin"']),
    ("joint_torque", "joint_force", ["torque", "joint_force"]),
])
def test_a_wrong_joint_torque_is_named(tmp_path, old, new, words):
    path = saved(tmp_path / "one.toml", SCENE.replace("VALUE", "1.0").replace(old, new))
    with pytest.raises(crosscheck.SceneError) as caught:
        crosscheck.load_scene(path)
    if "torque" not in words:
        assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(("lines", "words"), [
    ('position = 0.1\ndrive = { type = "polynomial", coefficients = [0.1] }', ["position", "remove it"]),
    ('drive = 0.3', ["drive"]),
    ('drive = { type = "spline", times = [0.0, 0.2], values = [0.0, 1.0] }', ["drive: times", "cover the whole run"]),
])
def test_a_wrong_drive_is_named(tmp_path, lines, words):
    path = tmp_path / "one.toml"
    path.write_text(SCENE.replace("VALUE", "1.0").replace('type = "revolute"', f'type = "revolute"\n{lines}'))
    with pytest.raises(crosscheck.SceneError) as caught:
        crosscheck.load_scene(path)
    assert all(word in str(caught.value) for word in ["joints[0]", *words])


def test_a_drive_says_where_its_joint_starts(tmp_path):
    path = tmp_path / "one.toml"
    drive = 'type = "revolute"\ndrive = { type = "polynomial", coefficients = [0.4, 1.5, 2.0] }'
    path.write_text(SCENE.replace("VALUE", "1.0").replace('type = "revolute"', drive))
    traj = crosscheck.run(path, engine="lieeuler", method="taylor", rtol=1e-12)
    np.testing.assert_allclose(traj.joints["pin"].position, 0.4 + 1.5 * traj.t + 2.0 * traj.t**2, rtol=0, atol=1e-14)
    np.testing.assert_allclose(traj.joints["pin"].velocity, 1.5 + 4.0 * traj.t, rtol=0, atol=1e-13)
    # the drive does the work: the torque of its multiplier is inertia about the pin times 4, less the other torques
    force, torque = traj.reactions["pin"]
    assert force.shape == torque.shape == (3, 3)


def test_functions_count_in_the_hash_and_numbers_are_as_before():
    scene = crosscheck.load_scene("driven_cart")
    force = scene.forces[0]
    moved = type(force)(force.type, None, None, force.joint, {"force": force.parameters["force"].delayed(1e-3)})
    assert scene.replace(forces=(moved, *scene.forces[1:])).hash != scene.hash
    assert scene.timed
    assert scene.breaks == (0.5, 1.0, 1.5)
    assert not crosscheck.load_scene("double_pendulum").timed


@pytest.mark.parametrize("name", ["driven_cart", "driven_double_pendulum", "driven_slider_crank"])
@pytest.mark.parametrize("samples", [5, 31])
def test_energy_changes_by_the_work_however_few_the_outputs_are(name, samples):
    """Across breaks of functions of time, too."""
    traj = crosscheck.run(name, engine="lieeuler", method="taylor", rtol=1e-13, samples=samples)
    most = max(np.abs(traj.energy).max(), np.ptp(traj.energy))
    assert np.ptp(traj.energy) > 0.1
    np.testing.assert_allclose(traj.energy - traj.energy[0], traj.work, rtol=0, atol=1e-9 * most)


def test_a_spline_is_not_known_after_its_table():
    scene = crosscheck.load_scene("driven_cart")
    ends = {function.end for function in scene.functions}
    assert min(ends) == 2.0
    assert scene.delayed(0.5).lasting(2.5).duration == 2.5
    assert {function.times(2.0).plus(1.0).end for function in scene.functions} == ends
    for prolonged in (lambda: crosscheck.run(scene, "lieeuler", "rattle2", step=1e-2, duration=2.1),
                      lambda: scene.lasting(2.1),
                      lambda: crosscheck.flow_derivative(scene, 2.1)):
        with pytest.raises(crosscheck.SceneError, match="table of a spline of scene 'driven_cart' ends at 2 s"):
            prolonged()
