"""All tests of the PyMeshLab adapter, in a process of their own (see conftest.py)."""

import os
import subprocess
import sys
from pathlib import Path


def test_the_pymeshlab_adapter():
    tests = Path(__file__).with_name("test_pymeshlab_adapter.py")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n0", str(tests)],
        env=os.environ | {"EQUIMESH_ALONE": "1"}, cwd=tests.parents[1],
        capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout + run.stderr
    assert " passed" in run.stdout
