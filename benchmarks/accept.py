"""Every figure that equimesh is to show, measured through its public surface.

    python benchmarks/accept.py [--quick] [--write README.md]

Prints a table with a verdict for each figure; the exit status is 1 if one fails. Errors, covers and
distances are measured by ``independent.py``, which shares nothing with the package.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import commands
import independent
import numpy as np
from functions import FUNCTIONS, Case
from pydelatin import Delatin
from rows import Record, Row, table

import equimesh

_MARKS = ("<!-- measured -->", "<!-- end of measured -->")


def function_cases(quick: bool, record: Record) -> Iterator[Row]:
    """Eight functions at all their tolerances: cover, error, count over N*."""
    ratios, faults, errors = [], [], []
    for case in FUNCTIONS:
        for tol in case.tolerances[: 1 if quick else None]:
            ratio, fault, error = _function_case(case, tol, record)
            ratios.append(ratio)
            errors.append(error)
            if fault:
                faults.append(f"{case.name} at {tol:g}: {fault}")
    n = len(ratios)
    yield Row(
        f"eight functions, {n} cases: valid conforming cover, area to 1e-9",
        f"{n - len(faults)} of {n}{'; ' * bool(faults)}{'; '.join(faults)}",
        "all",
        not faults,
    )
    yield Row(
        "functions: largest error over the tolerance, at dense samples",
        f"at most {max(errors):.5f}; {sum(e <= 1.0 for e in errors)} of {n}",
        "at most 1 in each",
        max(errors) <= 1.0,
    )
    yield Row(
        "functions: triangles over N*",
        f"median {np.median(ratios):.3f}, at most {max(ratios):.3f}; "
        f"{sum(r <= 1.5 for r in ratios)} of {n}",
        "median 1.3, each 1.5",
        max(ratios) <= 1.5 and np.median(ratios) <= 1.3,
    )


def _function_case(case: Case, tol: float, record: Record) -> tuple[float, str, float]:
    started = time.perf_counter()
    result = equimesh.remesh(case, tol, case.box)
    seconds = time.perf_counter() - started
    count, least = len(result.triangles), case.least(tol)
    fault = independent.cover_fault(result.points, result.triangles, case.box)
    x, y, z = result.points.T
    if np.abs(case(x, y) - z).max() > 1e-12 * np.abs(z).max():
        fault = fault or "vertices off the surface"
    if not result.status.ok:
        fault = fault or result.status.value
    found = independent.function_error(case, result.points, result.triangles)
    record.bound(f"{case.name} at {tol:g}", result.profile.bound, found)
    figures = (f"{least:.0f}", f"{count}", f"{count / least:.3f}", f"{found / tol:.4f}")
    record.cases.append((case.name, f"{tol:g}", *figures, f"{seconds:.2f}"))
    print("    " + "  ".join(record.cases[-1]), flush=True)
    return count / least, fault, found / tol


def terrain(quick: bool, record: Record) -> Iterator[Row]:
    """Real elevations against greedy insertion at the same tolerance."""
    elevation = np.load(commands.jacksboro())["elevation"]
    rows, columns = elevation.shape
    box = (0.0, 0.0, columns - 1.0, rows - 1.0)
    x, y, z = independent.bilinear_samples(elevation, 8)
    for percent in (5,) if quick else (1, 2, 5):
        tol = 0.01 * percent * float(np.ptp(elevation))
        started = time.perf_counter()
        result = equimesh.remesh(elevation, f"{percent}%")
        seconds = time.perf_counter() - started
        points, triangles = result.points, result.triangles
        linear = independent.interpolated(points, triangles, x, y)
        errors = np.abs(linear - z)
        at_samples = errors.reshape((rows - 1) * 8 + 1, -1)[::8, ::8]
        found = float(errors.max())
        record.bound(f"jacksboro at {percent} %", result.profile.bound, found)
        fault = independent.cover_fault(points, triangles, box)
        name = f"jacksboro {rows} x {columns} at {percent} %"
        yield Row(f"{name}: exact cover of the rectangle", fault or "yes", "yes", not fault)
        yield Row(
            f"{name}: error over the tolerance, samples and bilinear surface",
            f"{float(at_samples.max()) / tol:.5f}, {found / tol:.5f}",
            "at most 1",
            found <= tol and result.status.ok,
        )
        greedy = Delatin(elevation.astype(np.float32), max_error=tol)
        count = len(greedy.triangles)
        # pydelatin counts rows from below.
        corners = np.array(greedy.vertices, float) * [1, -1, 1] + [0, rows - 1, 0]
        theirs = np.abs(independent.interpolated(corners, greedy.triangles, x, y) - z)
        there = float(theirs.reshape((rows - 1) * 8 + 1, -1)[::8, ::8].max())
        yield Row(
            f"{name}: triangles",
            f"{len(triangles):,} in {seconds:.1f} s; pydelatin {count:,} "
            f"(error {there / tol:.2f} at samples, {float(theirs.max()) / tol:.2f} between)",
            "fewer than pydelatin",
            len(triangles) < count,
        )


def speed(quick: bool, record: Record) -> Iterator[Row]:
    """Example 1 with many triangles, all kernels compiled."""
    case, tol = FUNCTIONS[0], 0.014 if quick else 0.0014
    equimesh.remesh(case, 0.1379, case.box)
    started = time.perf_counter()
    result = equimesh.remesh(case, tol, case.box)
    seconds = time.perf_counter() - started
    count = len(result.triangles)
    found = independent.function_error(case, result.points, result.triangles)
    fault = independent.cover_fault(result.points, result.triangles, case.box)
    record.bound(f"{case.name} at {tol:g}", result.profile.bound, found)
    stages = ", ".join(f"{name} {time:.2f}" for name, time in result.timings.items())
    yield Row(
        f"Example 1 at {tol:g}, warm: {count:,} triangles, {count / case.least(tol):.3f} N*, "
        f"in {seconds:.2f} s ({stages})",
        f"{count / seconds:,.0f} triangles a second",
        "20,000, certified",
        count / seconds >= 20_000 and result.status.ok and found <= tol and not fault,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer cases")
    parser.add_argument("--only", metavar="NAME", help="one section")
    parser.add_argument("--write", type=Path, metavar="README.md", help="put the tables there")
    options = parser.parse_args()
    quick, record = options.quick, Record()
    sections: dict[str, Callable[[], Iterator[Row]]] = {
        "functions": lambda: function_cases(quick, record),
        "terrain": lambda: terrain(quick, record),
        "scan": lambda: commands.range_scan(record),
        "speed": lambda: speed(quick, record),
        "paper": lambda: commands.paper(quick),
        "bytes": lambda: commands.same_bytes(quick),
        "odd": commands.odd_inputs,
        "bad": lambda: commands.bad_inputs(quick),
    }
    if options.only not in (None, *sections):
        parser.error(f"choose one of {' '.join(sections)}")
    started = time.perf_counter()
    equimesh.remesh("x**2 + y**3", 0.001, (0, 0, 1, 1))
    equimesh.remesh(np.sin(np.arange(900.0) ** 2).reshape(30, 30), 0.1)
    print(f"compiled in {time.perf_counter() - started:.0f} s", flush=True)
    rows: list[Row] = []
    for name, section in sections.items():
        if options.only not in (None, name):
            continue
        print(f"{name}:", flush=True)
        for row in section():
            print(f"  {row.what}: {row.figure} (asked: {row.asked}): {row.verdict}", flush=True)
            rows.append(row)
    if record.ratios:
        rows.append(record.tightness())
        for name, ratio in record.ratios.items():
            print(f"    bound over measurement {ratio:.6f}: {name}")
    page = _page(rows, record)
    print(f"\n{page}\n{time.perf_counter() - started:.0f} s")
    if options.write:
        _put(page, options.write)
    return int(any(row.passed is False for row in rows))


def _page(rows: list[Row], record: Record) -> str:
    """All figures in Markdown."""
    machine = f"{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}"
    verdicts = [(row.what, row.figure, row.asked, row.verdict) for row in rows]
    page = f"Measured on {machine}.\n\n" + table(("what", "figure", "asked", "met"), verdicts)
    if record.cases:
        head = ("function", "tol", "N\\*", "triangles", "N/N\\*", "error/tol", "seconds")
        page += "\n" + table(head, record.cases)
    return page


def _put(page: str, path: Path) -> None:
    """Between the two marks that the file has for it."""
    text = path.read_text(encoding="utf-8")
    before, after = text.index(_MARKS[0]) + len(_MARKS[0]), text.index(_MARKS[1])
    path.write_text(f"{text[:before]}\n{page}{text[after:]}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
