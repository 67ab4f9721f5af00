"""What the picture of a scene says of its joints, and what the address keeps of it, in a real browser."""

import pytest

SCENE = "scene-double_pendulum.html"


JOINT = {"parent": -1, "child": 0, "parent_anchor": [0, 0, 0], "child_anchor": [0, 0, 0], "parent_axis": [0, 0, 1]}
LEANING = [0.8, 0.6, 0.0, 0.0]  # the axis 0.28 up and 0.96 sideways
STEEPER = [0.8, 0.0, 0.6, 0.0]
UPRIGHT = [0.5**0.5, 0.5**0.5, 0.0, 0.0]
SPHERE, DISK, EDGE = ({**JOINT, "type": kind, "child_axis": axis} for kind, axis in (
    ("rolling_sphere", None), ("rolling_disk", [0, 0, 1]), ("knife_edge", [0, 1, 0])))


@pytest.mark.parametrize(("joint", "exact", "run", "gap"), [
    (SPHERE, ([0, 0, 0.3], LEANING), ([0.2, -0.1, 0.3], STEEPER), 0.0),
    (SPHERE, ([0, 0, 0.3], LEANING), ([0.2, -0.1, 0.31], STEEPER), 0.01),
    (DISK, ([0, 0, 0.288], LEANING), ([0.2, -0.1, 0.288], STEEPER), 0.0),
    (DISK, ([0, 0, 0.288], LEANING), ([0.2, -0.1, 0.3], UPRIGHT), 0.0),  # another height, as its lean is another
    (DISK, ([0, 0, 0.288], LEANING), ([0.2, -0.1, 0.3], STEEPER), 0.012),
    (EDGE, ([0, 0, 0], LEANING), ([0.2, -0.1, 0], STEEPER), 0.0),
    (EDGE, ([0, 0, 0], LEANING), ([0.2, -0.1, -0.002], STEEPER), 0.002)])
def test_what_rolls_elsewhere_is_not_open(watched, joint, exact, run, gap):
    page = watched.open(SCENE)
    poses = [[{"x": x, "q": q}] for x, q in (run, exact)]
    found = page.evaluate("([joint, run, exact]) => Geometry.opening(joint, run, exact)", [joint, *poses])
    assert found == pytest.approx(gap, abs=1e-12)


def test_an_address_without_camera_and_trails_is_the_first_view(watched):
    page = watched.open(SCENE)
    page.select_option("#run", label="mujoco RK4")  # writes the address
    plain = page.evaluate("location.hash")
    page.select_option("#trails", "all")
    page.locator("#stage").hover()
    page.mouse.wheel(0, -300)
    page.wait_for_function("location.hash.includes('camera') && location.hash.includes('trails')")
    page.evaluate("hash => { location.hash = hash; }", plain)
    page.wait_for_function("document.getElementById('trails').value === 'short'")
    page.locator("#scrub").evaluate("e => e.dispatchEvent(new Event('change'))")
    assert "camera" not in page.evaluate("location.hash")
