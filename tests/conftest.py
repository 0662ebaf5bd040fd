"""What all tests share."""

from hypothesis import HealthCheck, settings

# Compiled kernels make first runs slow: no deadline. The same cases every time, to repeat failures.
settings.register_profile(
    "equimesh",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("equimesh")
