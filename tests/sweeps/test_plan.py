"""Sweep files: every mistake is one sentence with its correction, before anything runs."""

from __future__ import annotations

import pytest

from crosscheck.errors import CrosscheckError
from crosscheck.running.run import run
from crosscheck.sweeps import plan

GOOD = {"scenes": ["double_pendulum"], "engines": {"lieeuler": ["rattle2", "taylor"]}, "steps": [1e-2, 5e-3],
        "rtols": [1e-8]}


def test_cells_are_counted():
    asked = plan.read(GOOD | {"parameters": {"bodies.upper.mass": [0.9, 1.1], "gravity.2": [-9.0, -9.81]},
                              "perturb": {"attitude": 1e-3, "count": 5}})
    assert [(way.method, way.step, way.rtol) for way in asked.ways] == [
        ("rattle2", 1e-2, None), ("rattle2", 5e-3, None), ("taylor", None, 1e-8)]
    assert asked.cells == 4 * 5 * 3


@pytest.mark.parametrize("options", [{"coordinate_map": "cayley"}, {"polish": False}, {"reduce": "off"},
                                     {"method": "generalized_alpha", "spectral_radius": 0.5}])
def test_a_sweep_takes_every_option_of_run(options):
    engines = {"lieeuler": [{"method": "DAE1L_LSE"} | options]}
    (way,) = plan.read(GOOD | {"engines": engines, "steps": [0.01], "rtols": []}).ways
    assert {"method": way.method, **way.arguments} == {"method": "DAE1L_LSE", "step": 0.01} | options
    run("single_pendulum", way.engine, way.method, duration=0.1, **way.arguments)


@pytest.mark.parametrize(("change", "words"), [
    ({"scene": ["double_pendulum"]}, "'scene' is not known; did you mean 'scenes'"),
    ({"scenes": []}, "scenes: a list of names or paths is wanted"),
    ({"scenes": ["duble_pendulum"]}, "duble_pendulum"),
    ({"steps": [], "rtols": []}, "steps: missing"),
    ({"steps": [-1.0]}, "steps: positive numbers are wanted"),
    ({"steps": []}, "rattle2 needs steps"),
    ({"rtols": []}, "taylor needs rtols"),
    ({"samples": 1}, "samples: a whole number of at least 2"),
    ({"duration": 0}, "duration: positive"),
    ({"engines": {}}, "engines: a table"),
    ({"engines": {"lieeuler": ["ratle2"]}}, "did you mean 'rattle2'"),
    ({"engines": {"lieuler": ["rattle2"]}}, "lieuler"),
    ({"engines": {"lieeuler": [{"method": "rattle2", "fom": "maximal"}]}}, "did you mean 'form'"),
    ({"parameters": {"bodies.uper.mass": [1.0]}}, "has no 'bodies.uper'; did you mean 'bodies.upper'"),
    ({"parameters": {"bodies.upper.mas": [1.0]}}, "did you mean 'bodies.upper.mass'"),
    ({"parameters": {"bodies.upper.name": [1.0]}}, "this is no number"),
    ({"parameters": {"bodies.upper.mass": [[1.0, 2.0]]}}, "is not like"),
    ({"perturb": {"count": 3}}, "nothing is perturbed"),
    ({"perturb": {"attitude": 1e-3}}, "perturb.count: missing"),
    ({"perturb": {"atitude": 1e-3, "count": 3}}, "did you mean 'attitude'"),
    ({"perturb": {"attitude": 1e-3, "count": 0}}, "perturb.count: a whole number"),
    ({"perturb": {"attitude": 1e-3, "count": 3, "sampling": "sobol"}}, "perturb.sampling"),
    ({"perturb": {"bodies.uper.mass": 0.1, "count": 3}}, "bodies.uper"),
])
def test_a_mistake_is_one_sentence(change, words):
    with pytest.raises(CrosscheckError) as caught:
        plan.read(GOOD | change)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_is_named(tmp_path):
    file = tmp_path / "sweep.toml"
    file.write_text('scenes = ["double_pendulum"]\nstep = [1e-3]\n')
    with pytest.raises(CrosscheckError, match=r"sweep\.toml: key of a sweep: 'step'"):
        plan.read(file)
    with pytest.raises(CrosscheckError, match="cannot be read"):
        plan.read(tmp_path / "none.toml")
    file.write_text("scenes = [")
    with pytest.raises(CrosscheckError, match="neither TOML nor JSON"):
        plan.read(file)
