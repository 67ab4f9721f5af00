"""Settings shared by all tests."""

import os

from hypothesis import settings

# Shared machines stall: an example is never late. CI draws the same examples every time, a developer new ones.
settings.register_profile("house", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("house")
