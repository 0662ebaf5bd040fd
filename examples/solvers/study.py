"""What the solvers' scripts share: a family of meshes, a rate, and programs that may be absent."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["Absent", "Study", "run", "show", "tolerances"]


class Absent(Exception):
    """The solver is not installed; the text says how to get it."""


@dataclass(frozen=True)
class Study:
    """Errors of a solver's answers against the closed form on a family of meshes.

    ``triangles`` (k,) counts, ``errors`` (k,) in the norm that ``what`` names, ``note`` what else
    is worth knowing.
    """

    what: str
    triangles: tuple[int, ...]
    errors: tuple[float, ...]
    note: str = ""

    @property
    def rate(self) -> float:
        """The slope of log error against log h, with h = N^(-1/2)."""
        h = -0.5 * np.log(self.triangles)
        return float(np.polyfit(h, np.log(self.errors), 1)[0])


def tolerances(first: float) -> tuple[float, float, float]:
    """A tolerance divided by 4 twice: the triangles' sides halve, for linear interpolation."""
    return first, first / 4.0, first / 16.0


def run(package: str, *command: str | Path, cwd: Path) -> str:
    """What a program prints; Absent names its Debian package, and a failure is shown in full."""
    if shutil.which(command[0]) is None:
        raise Absent(f"{command[0]} is not installed: apt-get install {package}")
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout


def show(study: Callable[[Path], Study]) -> None:
    """Run a study in a folder that is removed afterwards, and print it; absence ends politely."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            made = study(Path(folder))
        except Absent as absent:
            sys.exit(str(absent))
    print(made.what)
    for triangles, error in zip(made.triangles, made.errors, strict=True):
        print(f"  {triangles:7,} triangles  error {error:.3e}")
    print(f"  rate {made.rate:.3f}" + f"; {made.note}" * bool(made.note))
