"""lieeuler with only the methods of these tests."""

from crosscheck.adapters.lieeuler import LieEuler


class Few(LieEuler):
    """One method of each of three orders."""

    methods = ("DAE1L_LSE", "rattle2", "rattle4")


class Ten(LieEuler):
    """The eight Euler methods and two of RATTLE: enough times to tell noise from a slowdown."""

    methods = (*(method for method in LieEuler.methods if method.startswith("DAE")), "rattle2", "rattle4")
