"""Settings of all tests."""

import os

from hypothesis import settings

# No test measures time. CI draws the same examples each time; everyone else helps to find new ones.
settings.register_profile("interloc", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("interloc")
