"""Triangles against seconds and memory over decades, by stages; and the time of a cold start.

    python benchmarks/scaling.py [--cases F1 F6] [--efforts fast balanced] [--most 100000]
                                 [--no-cold]

Sizes go from 3,000 triangles by factors of about 3.2. Every mesh is made in a process of its own,
after two small ones that load all kernels; its memory is what the process then needs beyond that.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from functions import FUNCTIONS
from rows import Row, table

import equimesh

FEWEST = 3000
SLOPE, MEMORY = 1.1, 1500.0  # at most; bytes a triangle
RATE = {"fast": 60_000, "balanced": 20_000}  # triangles a second at about 300,000
LARGE = 200_000  # triangles from which rates are judged
ENOUGH = 30_000  # triangles from which memory is not that of small things
COLD = {"cached": 2.0, "never compiled": 60.0}  # seconds at most
HEAD = (
    "case", "effort", "tol", "triangles", "N/N\\*", "seconds", "triangles a second",
    "bytes a triangle", "by stages",
)  # fmt: skip
FIRST_CALL = "import equimesh; equimesh.remesh('exp(5*x)*sin(5*y)', 0.1379, (0, 0, 1, 1))"


class Run(NamedTuple):
    """One mesh; ``memory`` in bytes beyond what small meshes take, 0 where it is not more."""

    number: int
    effort: str
    tol: float
    triangles: int
    least: float
    seconds: float
    memory: float
    stages: dict[str, float]
    fault: str

    def cells(self) -> tuple[str, ...]:
        stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in self.stages.items())
        return (
            f"F{self.number}", self.effort, f"{self.tol:.3g}", f"{self.triangles:,}",
            f"{self.triangles / self.least:.3f}", f"{self.seconds:.2f}",
            f"{self.triangles / self.seconds:,.0f}", f"{self.memory / self.triangles:,.0f}", stages,
        )  # fmt: skip


def measured(number: int, effort: str, tol: float) -> Run:
    """In this process, which should be a fresh one."""
    case = FUNCTIONS[number - 1]
    for count in (200, 1000):
        equimesh.remesh(case, case.least(1.0) / count, case.box, effort=effort)
    equimesh.remesh(equimesh.Raster(np.eye(9)), 0.01)  # greedy insertion, which few functions need
    before = _peak()
    started = time.perf_counter()
    result = equimesh.remesh(case, tol, case.box, effort=effort)
    seconds = time.perf_counter() - started
    fault = "" if result.status.ok and result.profile.bound <= tol else result.status.value
    return Run(
        number, effort, tol, len(result.triangles), case.least(tol), seconds, _peak() - before,
        dict(result.timings), fault,
    )  # fmt: skip


def _peak() -> float:
    """The largest memory that the process has held so far, in bytes."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size if sys.platform == "darwin" else 1024.0 * size


def apart(number: int, effort: str, tol: float) -> Run:
    """``measured`` in a process of its own."""
    code = "import json, sys, scaling; print(json.dumps(scaling.measured(*json.load(sys.stdin))))"
    run = subprocess.run(
        [sys.executable, "-c", code], input=json.dumps((number, effort, tol)), text=True,
        capture_output=True, cwd=os.path.dirname(os.path.abspath(__file__)), check=False,
    )  # fmt: skip
    if run.returncode != 0:
        raise RuntimeError(run.stderr.strip().splitlines()[-1] if run.stderr else "killed")
    return Run(*json.loads(run.stdout.splitlines()[-1]))


def sizes(most: int) -> list[int]:
    """From ``FEWEST`` to ``most`` in equal ratios of about sqrt(10)."""
    steps = max(1, round(2.0 * math.log10(most / FEWEST)))
    return [round(FEWEST * (most / FEWEST) ** (k / steps)) for k in range(steps + 1)]


def verdicts(number: int, effort: str, runs: list[Run]) -> Iterator[Row]:
    name = f"F{number}, {effort}"
    faults = [f"{run.tol:.3g}: {run.fault}" for run in runs if run.fault]
    yield Row(f"{name}: certified", "; ".join(faults) or "all", "all", not faults)
    logs = np.log([(run.triangles, run.seconds) for run in runs])
    slope = float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0]) if len(runs) > 1 else math.nan
    yield Row(
        f"{name}: slope of log seconds against log triangles, {runs[0].triangles:,} to "
        f"{runs[-1].triangles:,}",
        f"{slope:.3f}", f"at most {SLOPE}", slope <= SLOPE,
    )  # fmt: skip
    large = [run.memory / run.triangles for run in runs if run.triangles >= ENOUGH]
    yield Row(
        f"{name}: peak memory, bytes a triangle", f"{max(large, default=math.nan):,.0f}",
        f"at most {MEMORY:,.0f}", max(large) <= MEMORY if large else None,
    )  # fmt: skip
    for run in (run for run in runs if run.triangles >= LARGE):
        rate = run.triangles / run.seconds
        yield Row(
            f"{name}: triangles a second, {run.triangles:,}", f"{rate:,.0f}",
            f"at least {RATE[effort]:,}" if effort in RATE else "",
            rate >= RATE[effort] if effort in RATE else None,
        )  # fmt: skip


def cold_starts() -> Iterator[Row]:
    """The first call in a fresh process, import and all."""
    with tempfile.TemporaryDirectory() as folder:
        for name, again in (("never compiled", False), ("cached", True)):
            started = time.perf_counter()
            run = subprocess.run(
                [sys.executable, "-c", FIRST_CALL], env={**os.environ, "NUMBA_CACHE_DIR": folder},
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            seconds = time.perf_counter() - started
            said = " ".join((run.stdout + run.stderr).split())
            fine = run.returncode == 0 and seconds < COLD[name] and (again or bool(said))
            asked = f"under {COLD[name]:.0f} s" + ("" if again else ", with a line that says why")
            yield Row(
                f"first call in a fresh process, kernels {name}",
                f"{seconds:.1f} s" + (f', "{said[:100]}"' if said else ", no word"), asked, fine,
            )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=["F1", "F6"], metavar="CASE")
    parser.add_argument("--efforts", nargs="+", default=["fast", "balanced"])
    parser.add_argument("--most", type=int, default=100_000, help="triangles")
    parser.add_argument("--no-cold", action="store_true", help="leave cold starts out")
    options = parser.parse_args()
    cells, rows = [], []
    for number in (int(word.upper().lstrip("F")) for word in options.cases):
        case = FUNCTIONS[number - 1]
        for effort in options.efforts:
            runs = []
            for count in sizes(options.most):
                runs.append(apart(number, effort, case.least(1.0) / count))
                cells.append(runs[-1].cells())
                print("  ".join(cells[-1]), flush=True)
            rows += verdicts(number, effort, runs)
    if not options.no_cold:
        rows += cold_starts()
    print("\n" + table(HEAD, cells))
    lines = [(row.what, row.figure, row.asked, row.verdict) for row in rows]
    print(table(("what", "figure", "asked", "met"), lines))
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
