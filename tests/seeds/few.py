"""lieeuler with only the methods of these tests, which makes them quick."""

from crosscheck.adapters.lieeuler import LieEuler


class Few(LieEuler):
    """The eight Euler methods and two of RATTLE."""

    methods = (*(method for method in LieEuler.methods if method.startswith("DAE")), "rattle2", "rattle4")
