"""Settings of all tests."""

from hypothesis import settings

# Times are no matter of tests: the first example of a process may load a library.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
