"""What all tests share."""

import os
import sys

import pytest
from hypothesis import HealthCheck, settings

# Compiled kernels make first runs slow: no deadline. The same cases every time, to repeat failures.
settings.register_profile(
    "equimesh",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("equimesh")


# MeshLab's function filters now and then read what is not theirs (a segmentation fault inside
# libfilter_func): they are tested in a process of their own, by test_pymeshlab_alone.py.
collect_ignore = [] if os.environ.get("EQUIMESH_ALONE") else ["test_pymeshlab_adapter.py"]

VERDICT = pytest.StashKey[int]()


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[VERDICT] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """Leave at once: Gmsh, VTK, MeshLab, Mmg and LLVM in one process may crash on their way out.

    The verdict is printed by then; it is the exit status.
    """
    if VERDICT in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[VERDICT])
