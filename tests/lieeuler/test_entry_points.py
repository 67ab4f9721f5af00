"""Any input of the kernel's entry points gives an ArgumentError, a named status, or a finite trajectory."""

from __future__ import annotations

import dataclasses
import fractions
import importlib
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lieeuler
from lieeuler import _kernel
from tests import random_mechanisms
from tests.kernel_mutations import EXTREME, FIELDS, case, judged, layouts, patience
from tests.lieeuler.systems import SYSTEMS

T = np.linspace(0, 0.1, 3)


def field_values(problem):
    return {field.name: getattr(problem, field.name) for field in dataclasses.fields(problem)}


def outcome(fields, method, **arguments):
    return judged(lambda: lieeuler.Problem(**fields), method=method, **arguments)


@pytest.mark.parametrize("name", ["x", "R", "v", "w"])
def test_the_layout_of_an_array_changes_nothing(name):
    fields = field_values(SYSTEMS["double_pendulum"]())
    wanted = outcome(fields, "DAE1L_LSE", step=1e-2, t_eval=T)
    for values in layouts(fields[name]):
        found = outcome({**fields, name: values}, "DAE1L_LSE", step=1e-2, t_eval=T)
        assert found is not None
        assert all(np.array_equal(getattr(found, key), getattr(wanted, key)) for key in FIELDS)


def test_a_problem_keeps_no_one_elses_memory():
    fields = field_values(SYSTEMS["double_pendulum"]())
    shared = np.array(fields["x"])
    problem = lieeuler.Problem(**{**fields, "x": shared})
    shared[:] = np.nan
    assert np.array_equal(problem.x, fields["x"])
    aliased = np.zeros((1, 3))
    body, gravity = lieeuler.Body(1.0, np.eye(3)), np.zeros(3)
    free = lieeuler.integrate(lieeuler.Problem([body], [], gravity, aliased, np.eye(3)[None], aliased, aliased),
                              "rattle2", 1e-2, T)
    assert not free.x.any()
    assert not aliased.any()


def test_numbers_of_other_types_are_numbers():
    fields = field_values(SYSTEMS["single_pendulum"]())
    body = lieeuler.Body(fractions.Fraction(3, 2), np.eye(3, dtype=np.int32))
    assert type(body.mass) is float
    still = {name: np.zeros((1, 3), dtype=np.float32) for name in ("v", "w")}
    solution = outcome({**fields, "bodies": [body], "gravity": np.array([0, 0, -9], dtype=np.int8), **still},
                       "rattle2", step=np.float32(0.01), t_eval=range(2))
    assert solution.success


@pytest.mark.parametrize("value", [
    np.array([1j, 0, 0]), ["0", "0", "1"], [10**400, 0, 0], [0, 0], [[0, 0, 0]], None, [0, 0, 1e101], [0, 0, np.nan],
    np.ma.masked_equal([0.0, 0, 1], 1.0), 3, "abc",
], ids=repr)
def test_what_is_no_vector_is_named(value):
    fields = field_values(SYSTEMS["single_pendulum"]())
    with pytest.raises(lieeuler.ArgumentError, match="gravity"):
        lieeuler.Problem(**{**fields, "gravity": value})


@pytest.mark.parametrize("value", [10**400, 1e300, 5e-324, 1e-200, np.nan, fractions.Fraction(10**400), True, "1",
                                   None])
def test_masses_and_steps_out_of_range_are_named(value):
    with pytest.raises(lieeuler.ArgumentError, match="mass"):
        lieeuler.Body(value, np.eye(3))
    with pytest.raises(lieeuler.ArgumentError, match="step"):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), "rattle2", value, T)


@pytest.mark.parametrize("index", [-2, 2, 2**31, -(2**31), 2**40, 2**80])
def test_bodies_that_are_not_there_are_named(index):
    fields = field_values(SYSTEMS["double_pendulum"]())
    for joint in (lieeuler.spherical_joint(index, 0, [0, 0, 0], [0, 0, 1]),
                  lieeuler.spherical_joint(-1, index, [0, 0, 0], [0, 0, 1])):
        with pytest.raises(lieeuler.ArgumentError, match=r"joints\[0\]"):
            lieeuler.Problem(**{**fields, "joints": [joint]})
    with pytest.raises(lieeuler.ArgumentError, match=r"forces\[0\]"):
        lieeuler.Problem(**{**fields, "forces": [lieeuler.ConstantLoad(index)]})


@pytest.mark.parametrize("change", [{"bodies": 5}, {"joints": None}, {"forces": 1.0}, {"bodies": []},
                                    {"joints": ["a"]}])
def test_groups_that_are_no_sequences_are_named(change):
    with pytest.raises(lieeuler.ArgumentError, match=next(iter(change)).rstrip("s")[:3]):
        lieeuler.Problem(**{**field_values(SYSTEMS["single_pendulum"]()), **change})


@pytest.mark.parametrize("make", [
    lambda: lieeuler.Dot("parent", "sky"), lambda: lieeuler.Dot(["parent"], "child"),
    lambda: lieeuler.Dot("parent", "child", [0, 0]), lambda: lieeuler.Dot("parent", "child", constant=np.nan),
    lambda: lieeuler.Joint(-1, 0, np.zeros(3), np.zeros(3), spherical=2),
    lambda: lieeuler.Joint(-1, 0, np.zeros(3), np.zeros(3), dots=("parent",)),
    lambda: lieeuler.LinearSpring(-1, 0, np.zeros(3), np.zeros(3), 10**400, 0.0),
])
def test_rows_and_springs_are_checked(make):
    with pytest.raises(lieeuler.ArgumentError):
        make()


@pytest.mark.parametrize(("name", "value"), [
    ("map", ["exp"]), ("map", np.array(["exp", "cayley"])),
    ("reduce", ["planar"]), ("reduce", np.array(["planar", "off"])), ("monitor", None), ("monitor", "yes"),
    ("spin_free", "no"), ("t_eval", np.array([0, 1j])), ("t_eval", [-1e308, 1e308]), ("t_eval", ["0", "1"]),
    ("t_eval", [0, 10**400]), ("t_eval", [0, 5e-324]),
])
def test_wrong_options_are_named(name, value):
    with pytest.raises(lieeuler.ArgumentError, match=name):
        lieeuler.integrate(SYSTEMS["single_pendulum"](),
                           **{"method": "rattle2", "step": 1e-2, "t_eval": T, name: value})


def test_an_anchor_out_of_range_does_not_hide_an_open_joint():
    fields = field_values(SYSTEMS["single_pendulum"]())
    open_joint = lieeuler.spherical_joint(-1, 0, [1e99, 0, 0], [0, 0, 1.0])
    with pytest.raises(lieeuler.ArgumentError, match="violates the joints"):
        lieeuler.Problem(**{**fields, "joints": [open_joint]})


def test_an_inertia_turned_by_a_rotation_is_symmetric_enough():
    R = SYSTEMS["double_pendulum"]().R[0]
    inertia = R @ np.diag([1.0, 1.0 + 1e-14, 1.5]) @ R.T
    inertia[0, 1] += 1e-17
    lieeuler.Body(1.0, inertia)


numbers = st.one_of(st.sampled_from(EXTREME), st.floats(-10, 10))


@st.composite
def free_bodies(draw):
    """One body on a spring, with numbers of any size."""
    mass, *moments = (draw(st.one_of(st.sampled_from(EXTREME), st.floats(1e-3, 10))) for _ in range(2))
    vectors = {name: [[draw(numbers) for _ in range(3)]] for name in ("x", "v", "w")}
    return {"mass": mass, "moment": moments[0], "gravity": [draw(numbers) for _ in range(3)], **vectors,
            "stiffness": draw(numbers), "point": [draw(numbers) for _ in range(3)]}


@settings(max_examples=100)
@given(numbers=free_bodies(), method=st.sampled_from(sorted(lieeuler.METHODS)),
       t_end=st.sampled_from((1e-99, 1e-30, 1e-3, 0.1, 1e30, 1e99)))
def test_numbers_of_any_size(numbers, method, t_end):
    try:
        body = lieeuler.Body(numbers["mass"], np.diag([numbers["moment"]] * 3))
        spring = lieeuler.LinearSpring(-1, 0, np.zeros(3), numbers["point"], numbers["stiffness"], 0.1)
    except lieeuler.ArgumentError:
        return
    fields = {"bodies": [body], "joints": [], "gravity": numbers["gravity"], "R": [np.eye(3)], "forces": [spring],
              **{name: numbers[name] for name in ("x", "v", "w")}}
    # if steps follow a tolerance, a run takes as long as its duration asks
    if "step" in lieeuler.METHODS[method].controls:
        outcome(fields, method, step=t_end / 8, t_eval=[0, t_end / 2, t_end])
    elif t_end <= 0.1 and np.abs(numbers["w"]).max() < 1e3 and np.abs(numbers["v"]).max() < 1e3:
        outcome(fields, method, t_eval=[0, t_end / 2, t_end])


@pytest.mark.parametrize("seed", range(4))
def test_any_call_is_refused_or_ends_with_a_name(seed, monkeypatch):
    monkeypatch.setattr(importlib.import_module("lieeuler.methods"), "MOST_STEPS", 1e4)
    random = Random(seed)
    for _ in range(100):
        make, options = case(random)
        if options.get("step") is not None:  # odd numbers may need any number of steps
            judged(make, **options)


def test_an_unknown_word_is_no_level_map_or_carrier():
    """The kernel took every unknown level for the acceleration level, and every unknown map for exp."""
    for words, known in ((_kernel.Level, "velocity"), (_kernel.CoordinateMap, "exp"), (_kernel.Carrier, "parent"),
                         (_kernel.Formulation, "hamilton")):
        assert known in words.__members__
        with pytest.raises(KeyError):
            words["no such word"]
    for wrong in ("velocity", "no such word", 17, None):
        with pytest.raises(TypeError):
            _kernel.Method(_kernel.Formulation.lagrange, wrong, False, 0.0, 0.0, (), None, True,
                           _kernel.Correction.mass)
        with pytest.raises(TypeError):
            _kernel.map_values(wrong, np.zeros(3), np.eye(3), 1.0)


@pytest.mark.parametrize("seed", range(60))
def test_random_mechanisms_finish_or_say_why_not(seed):
    """Sixty inputs of `python -m benchmarks.fuzz mechanisms`; the first ones twice, equal to the last bit."""
    with patience(0.2):
        random_mechanisms.answer(Random(seed))
    if seed < 10:
        for first, second in zip(random_mechanisms.again(Random(seed)), random_mechanisms.again(Random(seed)),
                                 strict=True):
            np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("chunk", range(4))
@pytest.mark.parametrize("draw", ["mechanisms", "calls"])
def test_five_hundred_draws(draw, chunk):
    """Under the sanitizers: `tools/sanitize -k five_hundred tests/lieeuler/test_entry_points.py`."""
    for seed in range(1000 + 500 * chunk, 1500 + 500 * chunk):
        with patience(0.2):
            if draw == "mechanisms":
                random_mechanisms.answer(Random(seed))
            else:
                make, options = case(Random(seed))
                judged(make, **options)
