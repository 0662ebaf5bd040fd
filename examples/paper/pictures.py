"""The paper's figures: optimal triangles, meshes, error profiles, the top tenth of the errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cases import Case
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from strategies import Row

from equimesh.lattice import VARIANTS, optimal_triangle

__all__ = ["draw_example", "draw_triangles"]

_COLOURS = {
    "optimal shape (interior)": "#1b7837",
    "equilateral (cover)": "#2166ac",
    "adaptive finite elements": "#b2182b",
    "equimesh (cover, certified)": "#e08214",
}


def draw_triangles(path: Path) -> None:
    """Figures 1, 6 and 7."""
    figure = _figure(10.0, 3.4)
    first, second, third = figure.subplots(1, 3)
    one = optimal_triangle(-1, 2)
    first.add_collection(PolyCollection([one], facecolor="#1b783733", edgecolor="#1b7837"))
    for point, text in zip(one, ("(0, 0)", "(1, 0)", r"(1/2, $\sqrt{5}$/2)"), strict=True):
        first.annotate(text, point, textcoords="offset points", xytext=(4, 4))
    first.set_title("an optimal triangle (Fig. 1)")

    # A corner may slide along the hyperbola through it without changing its two edges' errors.
    small = np.array([[0.0, 0.0], [1.0, 0.0], [0.35, 0.8]])
    level = small[2, 0] ** 2 - small[2, 1] ** 2
    x = np.linspace(-0.4, 0.9, 200)
    second.plot(x, np.sqrt(x**2 - level), color="#888888")
    for corner, style in ((small[2], "solid"), ((0.75, np.sqrt(0.75**2 - level)), "dashed")):
        moved = np.vstack([small[:2], corner])
        second.add_collection(
            PolyCollection([moved], facecolor="none", edgecolor="#1b7837", linestyle=style)
        )
    second.set_title("a corner moved along\na hyperbola (Fig. 6)")

    shapes = [optimal_triangle(-1, variant) for variant in VARIANTS]
    third.add_collection(PolyCollection(shapes, facecolor="#1b783718", edgecolor="#1b7837"))
    for variant, shape in zip(VARIANTS, shapes, strict=True):
        third.annotate(f"V{variant}", shape[2], textcoords="offset points", xytext=(3, 3))
    third.set_title("the six shapes (Fig. 7)")
    for axes in (first, second, third):
        axes.set_aspect("equal")
        axes.autoscale()
        axes.margins(0.12)
    _save(figure, path)


def draw_example(case: Case, rows: list[Row], folder: Path) -> list[str]:
    """Three pictures of an example; their file names."""
    chosen = [rows[0], *rows[2:]]
    names = [f"example{case.number}-{kind}.png" for kind in ("profiles", "meshes", "top-tenth")]

    figure = _figure(7.0, 4.2)
    axes = figure.subplots()
    for row in chosen:
        share = (np.arange(row.errors.size) + 0.5) / row.errors.size
        label = f"{row.strategy}, {row.errors.size} triangles"
        axes.plot(share, np.sort(row.errors), color=_COLOURS[row.strategy], label=label)
    axes.set_yscale("log")
    axes.set_xlabel("share of the triangles")
    axes.set_ylabel("largest error of a triangle")
    axes.set_title(f"Example {case.number}: errors in ascending order")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    _save(figure, folder / names[0])

    figure = _figure(10.0, 3.1)
    for axes, row in zip(figure.subplots(1, len(chosen)), chosen, strict=True):
        _mesh(axes, row, np.arange(row.errors.size), "none")
        axes.set_title(f"{row.strategy}\n{row.errors.size} triangles", fontsize=8)
    _save(figure, folder / names[1])

    figure = _figure(7.6, 3.1)
    covers = rows[2:]
    for axes, row in zip(figure.subplots(1, len(covers)), covers, strict=True):
        top = np.flatnonzero(row.errors >= np.quantile(row.errors, 0.9))
        _mesh(axes, row, top, _COLOURS[row.strategy])
        axes.set_title(f"{row.strategy}\ntop tenth of the errors", fontsize=8)
    _save(figure, folder / names[2])
    return names


def _mesh(axes, row: Row, which: np.ndarray, fill: str) -> None:
    axes.add_collection(
        PolyCollection(
            row.points[row.triangles[which]], facecolor=fill, edgecolor="#333333", linewidth=0.25
        )
    )
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=110, metadata={"Software": None})
