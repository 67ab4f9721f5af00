"""Lie group Euler integrators for rigid multibody systems with joints; conventions in `lieeuler.types`."""

from lieeuler.errors import ArgumentError, IntegrationError, Interrupted
from lieeuler.integrate import integrate
from lieeuler.methods import COORDINATE_MAPS, EULER_METHODS, METHODS, Method
from lieeuler.problem import Body, Dot, Joint, Problem, spherical_joint
from lieeuler.solution import Solution, Stats, Status

__all__ = ["COORDINATE_MAPS", "EULER_METHODS", "METHODS", "ArgumentError", "Body", "Dot", "IntegrationError",
           "Interrupted", "Joint", "Method", "Problem", "Solution", "Stats", "Status", "integrate", "spherical_joint"]
