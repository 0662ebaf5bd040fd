"""equimesh at three efforts beside Mmg2d, BAMG, Gmsh and pydelatin: eight functions, one table.

    python benchmarks/peers.py [--cases F1 F6:0.001 ...] [--tools equimesh mmg2d bamg ...]
                               [--efforts fast balanced best]

Every mesh keeps the tolerance at dense samples. The others' searches are described in
``peer_tools.py``; their seconds are those of the tools alone, of all passes of the search and of
the one pass that made the mesh. equimesh's are those of one call, all kernels compiled.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

import independent
import numpy as np
import peer_tools
from functions import FUNCTIONS, Case
from rows import Row, table

import equimesh

EFFORTS = ("fast", "balanced", "best")
FOLLOWERS = ("mmg2d", "bamg", "gmsh")  # of a metric
HEAD = ("case", "tol", "N\\*", "tool", "triangles", "N/N\\*", "error/tol", "seconds", "of one pass")
# Triangles of equimesh, balanced, over those of the best of the others.
ASKED = {1: 0.49, 2: 0.49, 3: 0.49, 4: 0.49, 5: 0.75, 6: 0.55, 7: 0.55, 8: 0.55}
PASSES = 5  # single passes of the others in whose time the tolerance is to be reached


class Line(NamedTuple):
    """A tool on a case; 0 triangles where it found no mesh within the tolerance."""

    number: int  # of the function, from 1
    tol: float
    least: float
    tool: str
    triangles: int
    error: float
    seconds: float
    one: float

    @property
    def ratio(self) -> float:
        return self.triangles / self.least if self.triangles else math.nan

    def cells(self) -> tuple[str, ...]:
        count = f"{self.triangles:,}" if self.triangles else "none"
        return (
            f"F{self.number}", f"{self.tol:g}", f"{self.least:.0f}", self.tool, count,
            f"{self.ratio:.3f}", f"{self.error:.4f}", f"{self.seconds:.3f}", f"{self.one:.3f}",
        )  # fmt: skip


def ours(case: Case, tol: float, effort: str) -> tuple[int, float, float, str]:
    """Triangles, error over the tolerance, seconds, and what is wrong with the mesh."""
    started = time.perf_counter()
    result = equimesh.remesh(case, tol, case.box, effort=effort)
    seconds = time.perf_counter() - started
    error = independent.function_error(case, result.points, result.triangles) / tol
    fault = independent.cover_fault(result.points, result.triangles, case.box)
    if not result.status.ok:
        fault = fault or result.status.value
    if error > 1.0:
        fault = fault or f"the error is {error:.5f} of the tolerance"
    return len(result.triangles), error, seconds, fault


def lines(
    cases: list[tuple[int, float]], tools: list[str], efforts: list[str], faults: list[str]
) -> Iterator[Line]:
    for number, tol in cases:
        case = FUNCTIONS[number - 1]
        least = case.least(tol)
        for effort in efforts if "equimesh" in tools else ():
            count, error, seconds, fault = ours(case, tol, effort)
            if fault:
                faults.append(f"F{number} at {tol:g}, {effort}: {fault}")
            yield Line(number, tol, least, effort, count, error, seconds, math.nan)
        for tool in tools:
            if tool != "equimesh":
                found = peer_tools.searched(tool, case, tol)
                for problem in sorted(set(found.faults)):
                    print(f"    {tool}, F{number} at {tol:g}: {problem}", flush=True)
                yield Line(
                    number, tol, least, tool, found.triangles, found.error, found.seconds, found.one
                )


def ratios(made: list[Line]) -> Iterator[Row]:
    """Triangles over N*, effort by effort."""
    for effort in EFFORTS:
        own = [line for line in made if line.tool == effort]
        if not own:
            continue
        over = [line for line in own if line.ratio > _limit(effort, line.least)]
        missed = [f"F{line.number} at {line.tol:g} {line.ratio:.3f}" for line in over]
        median = float(np.median([line.ratio for line in own]))
        asked = {
            "fast": "at most 1.25 where N* is 390 or more",
            "balanced": "at most 1.15 where N* is 390 or more",
            "best": "at most 1.20 below N* = 390, 1.10 to 1,000, 1.06 above; median 1.06",
        }[effort]
        yield Row(
            f"{effort}: triangles over N*, {len(own)} cases",
            f"median {median:.3f}, at most {max(line.ratio for line in own):.3f}"
            f"{'; missed by ' * bool(missed)}{', '.join(missed)}",
            asked,
            not missed and (effort != "best" or median <= 1.06),
        )


def _limit(effort: str, least: float) -> float:
    if effort == "best":
        return 1.2 if least < 390 else 1.1 if least <= 1000 else 1.06
    return math.inf if least < 390 else {"fast": 1.25, "balanced": 1.15}[effort]


def against(made: list[Line]) -> Iterator[Row]:
    """Balanced against the best of those that follow a metric, case by case."""
    for own in (line for line in made if line.tool == "balanced"):
        name = f"F{own.number} at {own.tol:g}"
        others = [
            line for line in made
            if line[:2] == own[:2] and line.tool in FOLLOWERS and line.triangles
        ]  # fmt: skip
        if not others:
            yield Row(f"{name}: against the others", "none ran", "", None)
            continue
        best = min(others, key=lambda line: line.triangles)
        share, asked = own.triangles / best.triangles, ASKED[own.number]
        yield Row(
            f"{name}: triangles over those of the best other ({best.tool}, {best.triangles:,})",
            f"{share:.3f}", f"at most {asked}", share <= asked,
        )  # fmt: skip
        search, single = min(line.seconds for line in others), min(line.one for line in others)
        yield Row(
            f"{name}: seconds, {own.seconds:.2f}, over those of the shortest search, "
            f"{search:.2f}, and of {PASSES} of the shortest single passes, {PASSES * single:.2f}",
            f"{own.seconds / search:.2f}, {own.seconds / (PASSES * single):.2f}",
            "less than 1, both",
            own.seconds < min(search, PASSES * single),
        )


def chosen(words: list[str] | None) -> list[tuple[int, float]]:
    """Numbers and tolerances of cases such as ``F6`` or ``F6:0.001``; all without words."""
    every = [(k, tol) for k, case in enumerate(FUNCTIONS, 1) for tol in case.tolerances]
    if not words:
        return every
    cases = []
    for word in words:
        name, _, tol = word.upper().lstrip("F").partition(":")
        own = [case for case in every if case[0] == int(name)]
        cases += [(int(name), float(tol))] if tol else own
    return cases


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", metavar="CASE", help="such as F1 or F6:0.001")
    every = ["equimesh", *peer_tools.TOOLS]
    parser.add_argument("--tools", nargs="+", choices=every, default=every)
    parser.add_argument("--efforts", nargs="+", choices=EFFORTS, default=list(EFFORTS))
    options = parser.parse_args()
    tools = []
    for tool in options.tools:
        absent = "" if tool == "equimesh" else peer_tools.missing(tool)
        if absent:
            print(f"{tool} is left out: {absent} is not installed")
        else:
            tools.append(tool)
    if "equimesh" in tools:
        # Kernels are loaded once: those of lattices, of meshes that are annealed, and of wide ones.
        wave, franke, peaks = FUNCTIONS[0], FUNCTIONS[5], FUNCTIONS[7]
        for case, tol in (
            (wave, 10.0 * wave.tolerances[0]),
            (franke, 10.0 * franke.tolerances[0]),
            (peaks, peaks.tolerances[1]),
        ):
            equimesh.remesh(case, tol, case.box)
    made: list[Line] = []
    faults: list[str] = []
    for line in lines(chosen(options.cases), tools, options.efforts, faults):
        made.append(line)
        print("  ".join(line.cells()), flush=True)
    print("\n" + table(HEAD, [line.cells() for line in made]))
    rows = [*ratios(made), *against(made)]
    if "equimesh" in tools:
        count = sum(line.tool in EFFORTS for line in made)
        rows.append(
            Row(
                "equimesh: valid covers, certified, errors at most the tolerance",
                f"{count - len(faults)} of {count}{'; ' * bool(faults)}{'; '.join(faults)}",
                "all",
                not faults,
            )
        )
    verdicts = [(row.what, row.figure, row.asked, row.verdict) for row in rows]
    print(table(("what", "figure", "asked", "met"), verdicts))
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
