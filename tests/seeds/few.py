"""lieeuler with the methods that these tests are about: quick, and no other method's verdict ends in them."""

from crosscheck.adapters.lieeuler import LieEuler


class Few(LieEuler):
    """The eight Euler methods and two of RATTLE."""

    methods = (*(method for method in LieEuler.methods if method.startswith("DAE")), "rattle2", "rattle4")
