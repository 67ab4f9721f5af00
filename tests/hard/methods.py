"""The methods of the kernel with a fixed step, and one way to run them."""

import lieeuler

FIXED = tuple(name for name, method in lieeuler.METHODS.items() if "step" in method.controls)
MOMENTUM = tuple(name for name in FIXED if lieeuler.METHODS[name].formulation == "hamilton")
