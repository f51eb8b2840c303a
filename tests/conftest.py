"""Settings for all tests."""

from hypothesis import settings

# A slow machine is not a wrong result: Hypothesis' limit of 200 ms per example would fail tests at random.
settings.register_profile("sentinel", deadline=None)
settings.load_profile("sentinel")
