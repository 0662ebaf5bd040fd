"""Who waits for the compiler is told, once; who does not, is not."""

import logging
import os
import subprocess
import sys

import pytest
from numba import njit

from equimesh import compiling

RUN = "import equimesh; equimesh.remesh('x*y', 0.05, (0, 0, 1, 1), effort='fast')"


def compile_some():
    for number in range(3):
        njit(lambda x, k=number: x + k)(1.0)


@pytest.mark.parametrize("patience, lines", [(0.0, 1), (1e9, 0)])
def test_long_compilation_is_told_once(monkeypatch, caplog, patience, lines):
    monkeypatch.setattr(compiling, "_PATIENCE", patience)
    with caplog.at_level(logging.WARNING, logger="equimesh"), compiling.announced():
        compile_some()
    assert len(caplog.records) == lines


def test_outside_nothing_is_told(monkeypatch, caplog):
    monkeypatch.setattr(compiling, "_PATIENCE", 0.0)
    with compiling.announced():
        pass
    compile_some()
    assert not caplog.records


def test_cached_kernels_run_in_silence():
    for _ in range(2):  # the first run may have to compile
        run = subprocess.run(
            [sys.executable, "-c", RUN], capture_output=True, text=True, check=True, env=os.environ
        )
    assert run.stderr == ""


def test_what_a_function_does_not_need_is_not_loaded():
    slow = "{'scipy.sparse', 'scipy.spatial', 'scipy.integrate', 'scipy.interpolate', 'rasterio'}"
    subprocess.run(
        [sys.executable, "-c", f"{RUN}; import sys; assert not {slow} & set(sys.modules)"],
        check=True, env=os.environ,
    )  # fmt: skip
