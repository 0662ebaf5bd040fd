"""The paper's figures: optimal triangles, meshes, error profiles, the top tenth of the errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cases import Case
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image
from strategies import Row

from equimesh.lattice import VARIANTS, optimal_triangle

__all__ = ["draw_example", "draw_triangles"]

_COLOURS = {
    "optimal shape (interior)": "#1b7837",
    "equilateral (cover)": "#2166ac",
    "adaptive finite elements": "#b2182b",
    "equimesh (cover, certified)": "#d95f02",
}
# The paper's figures of each example: profiles; meshes and top tenths by strategy.
_PROFILE = {1: 2, 2: 3, 3: 4, 4: 5}
_MESH = {
    "optimal shape (interior)": (10, 15, 20, 25),
    "equilateral (cover)": (8, 13, 18, 23),
    "adaptive finite elements": (9, 14, 19, 24),
}
_TOP = {"equilateral (cover)": (11, 16, 21), "adaptive finite elements": (12, 17, 22)}


def draw_triangles(path: Path) -> None:
    """Figures 1, 6 and 7."""
    figure = _figure(11.0, 4.4)
    first, second, third = figure.subplots(1, 3)
    green = "#1b7837"
    one = optimal_triangle(-1, 2)
    first.add_collection(PolyCollection([one], facecolor=green + "33", edgecolor=green))
    for point, text, below in zip(
        one, ("(0, 0)", "(1, 0)", r"(1/2, $\sqrt{5}$/2)"), (True, True, False), strict=True
    ):
        _label(first, text, point, (0, -1 if below else 1))
    first.set_title("Fig. 1: an optimal triangle")

    # On the hyperbola about corner 3 through corner 1 the error of edge 31 stays as it is. Edge 12
    # had less error than the two others and still has, but the area has grown.
    three, two, before = np.array([0.0, 0.0]), np.array([1.0, 0.0]), np.array([0.35, 0.8])
    level = before[0] ** 2 - before[1] ** 2
    x = np.linspace(-0.25, 0.85, 200)
    second.plot(x, np.sqrt(x**2 - level), color="#888888")
    after = np.array([0.7, np.sqrt(0.7**2 - level)])
    for corner, style in ((before, "solid"), (after, "dashed")):
        second.add_collection(
            PolyCollection([[three, two, corner]], facecolor="none", edgecolor=green, ls=style)
        )
    second.annotate(
        "", after, before, arrowprops={"arrowstyle": "->", "connectionstyle": "arc3,rad=0.12"}
    )
    for point, text, side in (
        (three, "3", (-1, -1)),
        (two, "2", (1, -1)),
        (before, "1", (-1, 1)),
        (after, "1'", (1, -1)),
    ):
        _label(second, text, point, side)
    second.set_title("Fig. 6: a corner moved along a hyperbola")

    shapes = [optimal_triangle(-1, variant) for variant in VARIANTS]
    third.add_collection(PolyCollection(shapes, facecolor=green + "18", edgecolor=green))
    for variant, shape in zip(VARIANTS, shapes, strict=True):
        _label(third, f"V{variant}", shape[2], (0, np.sign(shape[2, 1])))
    third.set_title(r"Fig. 7: the six shapes for $\theta = 0$")
    for axes in (first, second, third):
        axes.set_aspect("equal")
        axes.autoscale()
        axes.margins(0.16)
    _save(figure, path)


def draw_example(case: Case, rows: list[Row], folder: Path) -> list[str]:
    """Three pictures of an example; their file names."""
    names = [f"example{case.number}-{kind}.png" for kind in ("profiles", "meshes", "top-tenth")]
    _draw_profiles(case, rows, folder / names[0])

    # As large as the page allows: three thousand triangles are to be told apart.
    figure = _figure(10.0, 10.6)
    chosen = [rows[0], *rows[2:]]
    for axes, row in zip(figure.subplots(2, 2).ravel(), chosen, strict=True):
        _mesh(axes, row.points[row.triangles], "none")
        axes.set_title(f"{_number(_MESH, row, case)}{row.strategy}, {row.errors.size} triangles")
    _save(figure, folder / names[1])

    figure = _figure(11.0, 4.3)
    covers = rows[2:]
    for axes, row in zip(figure.subplots(1, len(covers)), covers, strict=True):
        order = np.argsort(row.errors, kind="stable")
        top = order[int(0.9 * order.size) :]
        shade = np.linspace(0.0, 1.0, 9)[
            np.floor(8.999 * _rank(np.log(row.errors[top]))).astype(int)
        ]
        colours = LinearSegmentedColormap.from_list("", ["#f4f4f4", _COLOURS[row.strategy]])
        _mesh(axes, row.points[row.triangles[top]], colours(shade))
        low, high = row.errors[top[0]], row.errors[top[-1]]
        axes.set_title(
            f"{_number(_TOP, row, case)}{row.strategy},\n"
            f"top tenth of the errors: {low:.4g} (light) to {high:.4g} (dark)",
            fontsize=9,
        )
    _save(figure, folder / names[2])
    return names


def _draw_profiles(case: Case, rows: list[Row], path: Path) -> None:
    figure = _figure(8.0, 5.0)
    axes = figure.subplots()
    styles = ["solid", "dotted", *["solid"] * 3]
    for row, style in zip(rows, styles, strict=True):
        share = (np.arange(row.errors.size) + 0.5) / row.errors.size
        label = f"{row.strategy}, {row.errors.size} triangles"
        colour = _COLOURS[row.strategy]
        axes.plot(share, np.sort(row.errors), color=colour, label=label, linestyle=style)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("share of the triangles")
    axes.set_ylabel("largest error of a triangle")
    axes.set_title(f"Fig. {_PROFILE[case.number]}: errors in ascending order, {case.formula}")
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(alpha=0.3)
    _save(figure, path)


def _number(figures: dict[str, tuple[int, ...]], row: Row, case: Case) -> str:
    """The figure's number in the paper, where it has one."""
    numbers = figures.get(row.strategy, ())
    return f"Fig. {numbers[case.number - 1]}: " if case.number <= len(numbers) else ""


def _rank(values: np.ndarray) -> np.ndarray:
    """Values scaled to 0 ... 1."""
    return (values - values.min()) / max(float(np.ptp(values)), 1e-300)


def _mesh(axes, corners: np.ndarray, fill) -> None:
    axes.add_collection(
        PolyCollection(corners, facecolor=fill, edgecolor="#333333", linewidth=0.35)
    )
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])


def _label(axes, text: str, point: np.ndarray, side: tuple[float, float]) -> None:
    axes.annotate(
        text,
        point,
        textcoords="offset points",
        xytext=(7 * side[0], 7 * side[1]),
        ha={-1: "right", 0: "center", 1: "left"}[int(side[0])],
        va="bottom" if side[1] > 0 else "top",
    )


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    """As a PNG of 64 colours, which thin lines in few colours do not need more than."""
    figure.set_dpi(110)
    figure.canvas.draw()
    picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    picture.quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
