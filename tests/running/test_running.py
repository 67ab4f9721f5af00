"""Arguments of `crosscheck.run`, and the failures of engines."""

import dataclasses
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RawRun, RunSpec, steps_per_sample
from crosscheck.errors import ArgumentError, EngineError, SceneError, Unsupported
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from tests import SCENARIOS


@pytest.fixture(scope="module")
def scene() -> Scene:
    return crosscheck.load_scene("single_pendulum").replace(duration=0.2, samples=3)


@pytest.mark.parametrize(("arguments", "words"), [
    ({"engine": "mujocco"}, ["engine", "'mujocco'", "did you mean 'mujoco'", "exudyn"]),
    ({"engine": "adams"}, ["engine", "'adams'", "lieeuler", "pinocchio"]),
    ({"method": "rk4"}, ["method of mujoco", "did you mean 'RK4'", "implicitfast"]),
    ({"step": None}, ["step", "needs a fixed step"]),
    ({"step": None, "rtol": 1e-6}, ["rtol", "fixed step"]),
    ({"rtol": 1e-6}, ["step and rtol", "only one"]),
    ({"step": 0.0}, ["step", "positive"]),
    ({"step": -0.1}, ["step", "-0.1"]),
    ({"step": float("nan")}, ["step", "finite"]),
    ({"step": float("inf")}, ["step", "finite"]),
    ({"step": "0.1"}, ["step", "'0.1'"]),
    ({"step": True}, ["step", "True"]),
    ({"samples": 1}, ["samples", "at least 2"]),
    ({"samples": 2.5}, ["samples", "whole number"]),
    ({"duration": 0.0}, ["duration", "positive"]),
    ({"sample": 3}, ["option", "'sample'", "did you mean 'samples'"]),
    ({"coordinate_map": "exp"}, ["coordinate_map", "mujoco does not have this option", "form"]),
    ({"alpha": 5.0}, ["alpha", "mujoco does not have this option"]),
    ({"form": "forest"}, ["form", "'forest'", "tree, maximal, pivot"]),
    ({"monitor": "yes"}, ["monitor", "True or False"]),
])
def test_a_wrong_argument_is_named_with_what_is_allowed(scene: Scene, arguments: dict, words: list[str]) -> None:
    given = {"engine": "mujoco", "method": "RK4", "step": 0.01, **arguments}
    with pytest.raises(ArgumentError) as caught:
        crosscheck.run(scene, **given)
    assert isinstance(caught.value, ValueError)
    for word in words:
        assert word in str(caught.value)


def test_a_scene_name_or_path_in_place_of_a_scene(scene: Scene, tmp_path: Path) -> None:
    by_name = crosscheck.run("single_pendulum", "mujoco", "RK4", step=0.01, duration=0.2, samples=3)
    path = tmp_path / "mine.toml"
    path.write_text((SCENARIOS / "single_pendulum.toml").read_text())
    by_path = crosscheck.run(path, "mujoco", "RK4", step=0.01, duration=0.2, samples=3)
    whole = crosscheck.run(scene, "mujoco", "RK4", step=0.01)
    assert by_name.x.tolist() == by_path.x.tolist() == whole.x.tolist()
    assert crosscheck.truth(path).states.x.tolist() == crosscheck.truth("single_pendulum").states.x.tolist()
    with pytest.raises(SceneError, match="did you mean"):
        crosscheck.run("single_pendulun", "mujoco", "RK4", step=0.01)


@pytest.mark.parametrize(("call", "words"), [
    (lambda s: crosscheck.run(3, "mujoco", "RK4", step=0.1), r"^scene: .*not int"),
    (lambda s: crosscheck.truth(3), r"^scene: .*not int"),
    (lambda s: crosscheck.assert_agree(3, ["mujoco"]), r"^scene: .*not int"),
    (lambda s: crosscheck.run(s, ["mujoco"], "RK4", step=0.1), r"^engine: .*not list"),
    (lambda s: crosscheck.methods([]), r"^engine: .*not list"),
    (lambda s: crosscheck.run(s, "mujoco", np.array(["RK4", "Euler"]), step=0.1), r"^method: .*not ndarray"),
    (lambda s: crosscheck.run(s, "mujoco", None, step=0.1), r"^method: .*not NoneType"),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=np.array([0.1, 0.2])), r"^step: "),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=1j), r"^step: "),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=10**5000), r"^step: .*this int"),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=1e-300), r"^step: .*1e\+10 steps"),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=1e-3, duration=1e300), r"^step: .*shorter duration"),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=0.1, samples=10**30), r"^samples: "),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=0.1, form=["tree"]), r"^form: "),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=0.1, form=np.array(["tree", "x"])), r"^form: "),
    (lambda s: crosscheck.run(s, "lieeuler", "DAE1L_LSE", step=0.1, alpha="big"), r"^alpha: "),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=0.1, spin_free=1), r"^spin_free: True or False"),
    (lambda s: crosscheck.run(s, "mujoco", "RK4", step=0.1, monitor=np.array([True, False])), r"^monitor: "),
])
def test_an_argument_of_the_wrong_type_is_named(scene: Scene, call: Callable[[Scene], object], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        call(scene)


def test_numpy_scalars_are_numbers(scene: Scene) -> None:
    plain = crosscheck.run(scene, "mujoco", "RK4", step=0.01, samples=5, duration=0.4)
    for kind in (np.float16, np.float32, np.longdouble):
        found = crosscheck.run(scene, "mujoco", "RK4", step=kind("0.01"), samples=np.int64(5), duration=kind("0.4"),
                               monitor=np.False_, spin_free=np.False_)
        assert found.steps == plain.steps == 40  # with the float32 next below 0.01 it would be 44
        assert found.x.tolist() == plain.x.tolist()
        assert "energy_error" not in found.stats
    assert crosscheck.run(scene, "mujoco", "RK4", step=np.array(0.01), samples=np.array(3)).steps == 20


def test_numpys_false_is_false(scene: Scene) -> None:
    """NumPy's False is not the object False, and had asked for polished attitudes."""
    rough, same, polished = (crosscheck.run(scene, "lieeuler", "DAE1L_LSE", step=0.01, polish=polish)
                             for polish in (False, np.False_, True))
    assert same.R.tolist() == rough.R.tolist() != polished.R.tolist()


def test_lieeulers_argument_errors_reach_the_user_as_ours(scene: Scene) -> None:
    with pytest.raises(ArgumentError, match=r"^alpha=5.0 is for BAUMGARTE_LE; leave it out with DAE1L_LSE"):
        crosscheck.run(scene, "lieeuler", "DAE1L_LSE", step=0.01, alpha=5.0)
    with pytest.raises(ArgumentError, match=r"^rattle4 would fall to order 1 with ccsk, which is not symmetric"):
        crosscheck.run(scene, "lieeuler", "rattle4", step=0.01, coordinate_map="ccsk")


@pytest.mark.parametrize(("engine", "method", "form", "other"), [
    ("lieeuler", "DAE1L_LSE", "maximal", "tree"), ("mujoco", "RK4", "tree", "pivot"),
    ("pinocchio", "RKMK4", "tree", "pivot"), ("exudyn", "RK44", "pivot", "maximal"),
])
def test_every_engine_takes_form_and_spin_free(scene: Scene, engine: str, method: str, form: str, other: str) -> None:
    free = crosscheck.run(scene, engine, method, step=0.01)
    named = crosscheck.run(scene, engine, method, step=0.01, form=form, spin_free=False)
    assert named.form == form
    assert named.x.tolist() == free.x.tolist()
    with pytest.raises(Unsupported, match=rf"{engine} {method} .*form"):
        crosscheck.run(scene, engine, method, step=0.01, form=other)
    if engine == "lieeuler":  # supports spin-free frames, but nothing in this scene allows one
        assert crosscheck.run(scene, engine, method, step=0.01, spin_free=True).stats["spin_free"] == ()
        return
    with pytest.raises(Unsupported, match=f"{engine} {method}: spin_free=True"):
        crosscheck.run(scene, engine, method, step=0.01, spin_free=True)


def test_disagreeing_truth_is_a_public_error(scene: Scene) -> None:
    from crosscheck.references.base import TruthError

    assert crosscheck.TruthError is TruthError
    assert "TruthError" in crosscheck.__all__
    assert "TruthError" in crosscheck.truth.__doc__


def test_overrides_of_samples_and_duration(scene: Scene) -> None:
    run = crosscheck.run(scene, "mujoco", "RK4", step=0.01, samples=6, duration=0.5)
    assert run.t.tolist() == np.linspace(0.0, 0.5, 6).tolist()
    assert run.x.shape == (6, 1, 3)


def test_a_step_that_does_not_divide_the_sample_interval_is_shortened(scene: Scene) -> None:
    run = crosscheck.run(scene, "mujoco", "RK4", step=0.03)
    assert run.stats["step"] == 0.025  # four in an interval of 0.1 s
    assert run.steps == 8
    assert run.t.tolist() == scene.t.tolist()
    assert steps_per_sample(scene, 0.1) == (1, 0.1)
    assert steps_per_sample(scene, 7.0) == (1, 0.1)


def test_unsupported_says_engine_method_scene_and_reason(scene: Scene) -> None:
    with pytest.raises(Unsupported, match=r"mujoco RK4 on scene 'single_pendulum': form pivot"):
        crosscheck.run(scene, "mujoco", "RK4", step=0.01, form="pivot")


@dataclasses.dataclass
class _Broken:
    """An engine whose run fails, or answers with the given states."""

    failure: Exception | None = None
    states: States | None = None
    name: str = "broken"
    methods: tuple[str, ...] = ("only",)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        return None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        if self.failure:
            raise self.failure
        return RawRun(self.states, 0.0, 1, spec.step)


def _states(scene: Scene, samples: int) -> States:
    shape = (samples, scene.n)
    return States(scene.t[:samples], *(np.zeros((*shape, *rest)) for rest in ((3,), (3, 3), (3,), (3,))))


def _run_broken(scene: Scene, **kind: object) -> None:
    crosscheck.run(scene, _Broken(**kind), "only", step=0.1)


def test_an_engine_exception_becomes_an_engine_error_that_keeps_its_words(scene: Scene) -> None:
    with pytest.raises(EngineError, match="broken only: RuntimeError: matrix is singular") as caught:
        _run_broken(scene, failure=RuntimeError("matrix is singular"))
    assert isinstance(caught.value.__cause__, RuntimeError)
    with pytest.raises(EngineError, match="broken cannot be imported: No module named 'adams'"):
        _run_broken(scene, failure=ModuleNotFoundError("No module named 'adams'"))


@pytest.mark.parametrize("own", [EngineError("as it is"), Unsupported("as it is"), ArgumentError("as it is")])
def test_own_errors_pass_unchanged(scene: Scene, own: Exception) -> None:
    with pytest.raises(type(own), match=r"^as it is$"):
        _run_broken(scene, failure=own)


def test_non_finite_and_missing_samples_are_engine_errors(scene: Scene) -> None:
    states = _states(scene, 3)
    states.w[2, 0, 1] = np.nan
    with pytest.raises(EngineError, match=r"not finite at t = 0.2 s"):
        _run_broken(scene, states=states)
    with pytest.raises(EngineError, match="2 samples, not 3"):
        _run_broken(scene, states=_states(scene, 2))


def test_engine_names_by_function_and_by_package() -> None:
    assert crosscheck.engines() == adapters.names()
    assert crosscheck.engines()[:4] == ("lieeuler", "mujoco", "pinocchio", "exudyn")  # then those with environments
    assert crosscheck.methods("pinocchio") == ("SymplecticEuler", "RK4naive", "RKMK4", "RKMK8")
    with pytest.raises(ArgumentError, match="did you mean 'exudyn'"):
        crosscheck.methods("exudin")


def test_other_packages_offer_engines_by_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint, EntryPoints

    points = EntryPoints([EntryPoint("broken", f"{__name__}:_Broken", "crosscheck.engines"),
                          EntryPoint("mujoco", f"{__name__}:_Broken", "crosscheck.engines")])
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **wanted: points.select(**wanted))
    adapters._MADE.clear()
    try:
        assert adapters.names()[-1] == "broken"
        assert adapters.get("broken").methods == ("only",)
        assert adapters.get("mujoco").methods != ("only",)  # a built-in name stays built in
    finally:
        adapters._MADE.clear()


def test_importing_the_runner_loads_no_engine() -> None:
    code = ("import sys, crosscheck.running; "
            "print([name for name in ('mujoco', 'pinocchio', 'exudyn', 'lieeuler', 'scipy') if name in sys.modules])")
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
