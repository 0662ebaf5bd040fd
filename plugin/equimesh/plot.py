"""Pictures of a mesh: its triangles coloured by error, and its errors in ascending order."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from equimesh.profile import Profile

__all__ = ["check_plot", "draw_mesh", "draw_profile", "plot_profile", "save_plot"]

SUFFIXES = (".png", ".pdf", ".svg")
FEW = 20_000  # triangles whose edges can still be told apart
STRIPS = 256  # under a profile
COLOURS = "YlGnBu_r"  # dark where the tolerance is wasted, light where it is used
INK = "#1d2b45"


def check_plot(path: Path) -> None:
    """Raise InputError unless a picture of this name can be drawn."""
    _check_matplotlib()
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"A plot cannot be written as {path.name}: use {' '.join(SUFFIXES)}.")


def _check_matplotlib() -> None:
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError("Plots need matplotlib: run pip install 'equimesh[plot]'.") from None


def draw_mesh(axes: Axes, profile: Profile, tol: float | None = None) -> Any:
    """Seen from above, every triangle in the colour of its largest error; the collection."""
    x, y = profile.points[:, 0], profile.points[:, 1]
    few = len(profile.triangles) <= FEW
    collection = axes.tripcolor(
        x, y, profile.triangles, facecolors=profile.errors, cmap=COLOURS, vmin=0.0,
        vmax=_top(profile.errors, tol), edgecolors=INK if few else "face",
        linewidth=0.7 / max(1.0, (len(profile.triangles) / 1000) ** 0.5) if few else 0.1,
        rasterized=True,
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.margins(0.0)
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    _title(axes, f"{len(profile.triangles):,} triangles, coloured by largest error")
    return collection


def draw_profile(axes: Axes, errors: NDArray[np.float64], tol: float | None = None) -> None:
    """(m,) errors in ascending order, as D'Azevedo (1991) draws them, and the tolerance.

    The area below has the colours of ``draw_mesh``.
    """
    ascending = np.sort(errors)
    rank = (np.arange(len(ascending)) + 0.5) / max(len(ascending), 1)
    axes.plot(rank, ascending, color=INK, linewidth=1.6)
    if len(ascending):
        _fill(axes, rank, ascending, _top(errors, tol))
    if tol is not None:
        axes.axhline(
            tol, color="#c8402f", linestyle=(0, (4, 2)), linewidth=1.2, label=f"tolerance {tol:.4g}"
        )
        axes.legend(loc="lower right", framealpha=1.0)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.08 * _top(errors, tol))
    axes.set_xlabel("share of the triangles")
    axes.set_ylabel("largest error of a triangle")
    axes.spines[["top", "right"]].set_visible(False)
    _title(axes, "error profile: errors in ascending order")


def _fill(
    axes: Axes, rank: NDArray[np.float64], ascending: NDArray[np.float64], top: float
) -> None:
    """Strips from 0 up to the curve, each in the colour of its error."""
    from matplotlib.collections import PolyCollection

    ends = np.linspace(0.0, 1.0, STRIPS + 1)
    height = np.interp(ends, rank, ascending)
    left, right = ends[:-1], ends[1:]
    strips = np.stack(
        [
            np.stack([left, left, right, right]),
            np.stack([0 * left, height[:-1], height[1:], 0 * left]),
        ]
    ).transpose(2, 1, 0)
    filled = PolyCollection(list(strips), cmap=COLOURS, edgecolors="face", linewidths=0.5, zorder=1)
    filled.set_array(0.5 * (height[:-1] + height[1:]))
    filled.set_clim(0.0, top)
    axes.add_collection(filled, autolim=False)


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, loc="left", fontsize=11)


def plot_profile(profile: Profile, ax: Axes | None = None) -> Axes:
    """The error profile of a mesh, on ``ax`` or on a figure of its own; the axes.

    Raises InputError where matplotlib is missing.
    """
    if ax is None:
        _check_matplotlib()
        from matplotlib.figure import Figure

        ax = Figure(layout="constrained").subplots()
    draw_profile(ax, profile.errors)
    return ax


def save_plot(path: Path, profile: Profile, tol: float | None = None) -> None:
    """Both pictures side by side; the same profile gives the same bytes."""
    check_plot(path)
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    suffix = path.suffix.lower()
    with matplotlib.rc_context({"svg.hashsalt": "equimesh"}):
        figure = Figure(figsize=(11.0, 4.9), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2)
        collection = draw_mesh(left, profile, tol)
        beside = left.inset_axes((1.03, 0.0, 0.035, 1.0))  # as high as the mesh, whatever its shape
        figure.colorbar(collection, cax=beside, label="error").outline.set_visible(False)
        draw_profile(right, profile.errors, tol)
        # Without a date, since that alone would make two files differ.
        dated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
        figure.savefig(path, format=suffix[1:], dpi=150, metadata=dated.get(suffix))


def _top(errors: NDArray[np.float64], tol: float | None) -> float:
    """The end of the scales: above 0 even for a mesh without error."""
    return max(float(errors.max(initial=0.0)), tol or 0.0) or 1.0
