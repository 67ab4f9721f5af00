"""A variational integrator of order four, as an engine: docs/own-method.md."""

import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.states import States
from lieeuler.methods import MCLACHLAN_4, Rattle


class McLachlan4(Rattle, order=4, composition=MCLACHLAN_4, source="doi:10.1137/0916010"): ...


class Variational:
    name = "variational"
    methods = ("McLachlan4",)
    orders = {"McLachlan4": McLachlan4.order}  # noqa: RUF012

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        run = lieeuler.integrate(build_problem(scene), McLachlan4(step=spec.step), scene.t)
        return States(run.t, run.x, run.R, run.v, run.w, run.a, run.alpha, run.lam)
