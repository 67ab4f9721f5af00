"""lieeuler with only the methods of these tests."""

from crosscheck.adapters.lieeuler import LieEuler


class Few(LieEuler):
    """One method of each of three orders."""

    methods = ("DAE1L_LSE", "rattle2", "rattle4")


class Ten(LieEuler):
    """Ten methods, each resolved over the whole run: enough times to tell noise from a slowdown."""

    methods = ("DAE3L_LE", "DAE2L_LSE", "DAE1L_LSE", "DAE3H_LE", "DAE2H_LSE", "DAE1H_LSE", "rattle2", "rattle4",
               "rattle6", "rkmk4")
