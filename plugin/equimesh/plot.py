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
        x, y, profile.triangles, facecolors=profile.errors, cmap="viridis", vmin=0.0,
        vmax=_top(profile, tol), edgecolors="#00000066" if few else "face",
        linewidth=0.6 / max(1.0, (len(profile.triangles) / 2000) ** 0.5) if few else 0.1,
        rasterized=True,
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    axes.set_title(f"{len(profile.triangles):,} triangles by largest error")
    return collection


def draw_profile(axes: Axes, errors: NDArray[np.float64], tol: float | None = None) -> None:
    """(m,) errors in ascending order, as D'Azevedo (1991) draws them, and the tolerance."""
    ascending = np.sort(errors)
    rank = (np.arange(len(ascending)) + 0.5) / max(len(ascending), 1)
    axes.plot(rank, ascending, color="tab:blue")
    if tol is not None:
        axes.axhline(
            tol, color="tab:red", linestyle="--", linewidth=1.0, label=f"tolerance {tol:.4g}"
        )
        axes.legend(loc="lower right")
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("fraction of triangles")
    axes.set_ylabel("largest error of the triangle")
    axes.set_title("error profile")
    axes.grid(alpha=0.3)


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
        figure = Figure(figsize=(11.0, 5.0), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2)
        collection = draw_mesh(left, profile, tol)
        figure.colorbar(collection, ax=left, label="error")
        draw_profile(right, profile.errors, tol)
        # Without a date, since that alone would make two files differ.
        dated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
        figure.savefig(path, format=suffix[1:], dpi=150, metadata=dated.get(suffix))


def _top(profile: Profile, tol: float | None) -> float:
    """The colour scale's end: above 0 even for a mesh without error."""
    return max(float(profile.max), tol or 0.0) or 1.0
