"""The method of Crouch and Grossman of order three, as an engine: docs/own-method.md."""

import numpy as np

import lieeuler
from crosscheck.adapters.base import steps_per_sample
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.states import States
from lieeuler.reference import exp_series

STAGES = ((), (3 / 4,), (119 / 216, 17 / 108))
WEIGHTS = (13 / 51, -2 / 3, 24 / 17)


class CrouchGrossman:
    name = "cg3"
    methods = ("CG3",)
    orders = {"CG3": 3}  # noqa: RUF012

    def unsupported(self, scene, spec):
        moving = scene.servos or any(joint.drive for joint in scene.joints)
        return "its right-hand side knows no time" if moving else None

    def run(self, scene, spec):
        problem = build_problem(scene)
        steps, h = steps_per_sample(scene, spec.step)

        def moved(state, weights, slopes):
            x, R, v, w = state
            for weight, (velocity, spin, a, alpha) in zip(weights, slopes, strict=False):
                x, v, w = x + h * weight * velocity, v + h * weight * a, w + h * weight * alpha
                R = np.array([each @ exp_series(h * weight * turn) for each, turn in zip(R, spin, strict=True)])
            return x, R, v, w

        def slope(state):
            at = lieeuler.accelerations(problem, state)
            return state[2], state[3], at.a, at.alpha

        state = problem.x, problem.R, problem.v, problem.w
        kept = [(*state, *slope(state)[2:])]
        for _ in scene.t[1:]:
            for _ in range(steps):
                slopes = []
                for row in STAGES:
                    slopes.append(slope(moved(state, row, slopes)))
                state = lieeuler.project(problem, moved(state, WEIGHTS, slopes))
            kept.append((*state, *slope(state)[2:]))
        return States(scene.t, *(np.array(each) for each in zip(*kept, strict=True)))
