"""Kernels on disk: good as long as all that they call is what it was, and found by name."""

import os
import subprocess
import sys

import pytest

from equimesh.fields.compiled import compiled, outlined
from equimesh.fields.kernel_cache import digest

CALLEE = (
    "from equimesh.fields.compiled import {how}\n@{how}\ndef called(x):\n    return x + {more}\n"
)
INTRINSIC = """
from numba import types
from numba.extending import intrinsic
MORE = {more}
@intrinsic
def called(typing, x):
    def generated(context, builder, signature, args):
        return builder.fadd(args[0], context.get_constant(types.float64, MORE))
    return types.float64(types.float64), generated
"""
CALLER = """
from equimesh.fields.compiled import compiled
import callee
from callee import called
@compiled
def caller(x, y):
    return callee.called(x) * y
@compiled
def above(x):
    return caller(x, 2.0)
"""
ALL = """
import importlib, pkgutil
import equimesh
from numba.core.registry import CPUDispatcher
from equimesh.fields.kernel_cache import digest
for found in pkgutil.walk_packages(equimesh.__path__, "equimesh."):
    module = importlib.import_module(found.name)
    for name, part in sorted(vars(module).items()):
        if isinstance(part, CPUDispatcher):
            print(found.name, name, digest(part.py_func))
"""


def run(code, folder=None, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder,
        env={**os.environ, **environment},
    )  # fmt: skip
    return done.stdout


@pytest.mark.parametrize("how", ["compiled", "outlined"])
def test_a_change_in_another_file_is_noticed(tmp_path, how):
    (tmp_path / "caller.py").write_text(CALLER)
    code = "import caller; print(caller.above(3.0), sum(caller.above.stats.cache_hits.values()))"
    said = []
    for more in (1, 1, 4):
        (tmp_path / "callee.py").write_text(CALLEE.format(how=how, more=f"{more}.0"))
        said.append(run(code, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache")).split())
    assert said == [["8.0", "0"], ["8.0", "1"], ["14.0", "0"]]


def test_a_change_in_an_intrinsic_is_noticed(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    code = "import caller; print(caller.above(3.0), sum(caller.above.stats.cache_hits.values()))"
    said = []
    for more in (1, 1, 4):
        (tmp_path / "callee.py").write_text(INTRINSIC.format(more=f"{more}.0"))
        said.append(run(code, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache")).split())
    assert said == [["8.0", "0"], ["8.0", "1"], ["14.0", "0"]]


def test_what_is_compiled_with_a_kernel_from_disk_runs_from_disk(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(how="outlined", more="1.0"))
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run("import caller; print(caller.caller(3.0, 2.0))", tmp_path, **cache) == "8.0\n"
    for _ in range(2):  # compiled with ``caller`` from disk, then itself from disk
        assert run("import caller; print(caller.above(3.0))", tmp_path, **cache) == "8.0\n"


def test_digests_are_the_same_in_every_process():
    first, second = (run(ALL, PYTHONHASHSEED=seed) for seed in ("1", "2"))
    assert first == second
    assert len(first.splitlines()) > 150


@outlined
def apart(x):
    return x + 1.0


def test_an_outlined_kernel_is_called_and_not_copied(tmp_path, monkeypatch):
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))  # what is loaded cannot be read

    @compiled
    def caller(x):
        return 2.0 * apart(x)

    assert caller(1.0) == 4.0
    (code,) = caller.inspect_llvm().values()
    naming = [line for line in code.splitlines() if ".apart." in line]
    assert any(line.startswith("declare") for line in naming)
    assert not any(line.startswith("define") for line in naming)


def test_kernels_that_differ_in_a_number_have_different_digests():
    def known(number):
        space = {"number": number}
        exec("def f(x):\n    return x + number\n", space)
        return digest(space["f"])

    assert known(1.0) == known(1.0)
    assert known(1.0) != known(2.0)
