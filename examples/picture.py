"""Draws the README's picture, docs/picture.png: one function, its mesh and its error profile."""

from pathlib import Path

import equimesh
from equimesh.plot import save_plot

result = equimesh.remesh("exp(5*x) * sin(5*y)", tol=0.5, domain=(0, 0, 1, 1))
target = Path(__file__).parents[1] / "docs" / "picture.png"
save_plot(target, result.profile, result.tol)
print(f"{target}: {len(result.triangles)} triangles, N* = {result.lower_bound:.0f}")
