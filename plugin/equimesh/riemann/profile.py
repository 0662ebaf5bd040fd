"""Edge lengths and triangle qualities of a mesh in a metric."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.profile import Profile

if TYPE_CHECKING:
    from equimesh.riemann.metric import Metric

__all__ = ["MetricProfile", "metric_profile"]

Array = NDArray[np.float64]

_UNIT = (math.sqrt(0.5), math.sqrt(2.0))
_INK, _ACCENT = "#1d2b45", "#c8402f"


@dataclass(frozen=True, eq=False, kw_only=True)
class MetricProfile(Profile):
    """How near a mesh is to unit.

    Attributes
    ----------
    lengths
        (k,) metric lengths of the edges, each counted once.
    qualities
        (m,) ``4 sqrt(3) |K| / sum of squared edges`` in the mean metric of each triangle: 1 if
        equilateral, 0 if degenerate.
    errors, bounds
        (m,) one less the quality, as formats that store a number per triangle write it.
    """

    lengths: Array
    qualities: Array

    @property
    def share(self) -> float:
        """The share of edges with a metric length from 1/sqrt(2) to sqrt(2)."""
        inside = (self.lengths >= _UNIT[0]) & (self.lengths <= _UNIT[1])
        return float(inside.mean()) if len(inside) else 1.0

    @property
    def quality(self) -> float:
        """The mean quality of the triangles."""
        return float(self.qualities.mean()) if len(self.qualities) else 1.0

    def quantile(self, q: float) -> float:
        """The quality that a share ``q`` of the triangles does not exceed."""
        return float(np.quantile(self.qualities, q)) if len(self.qualities) else 1.0

    def plot(self, ax: Any = None) -> Any:
        """Draw a histogram of the metric lengths; returns the matplotlib axes.

        Raises InputError where matplotlib is missing.
        """
        if ax is None:
            try:
                from matplotlib.figure import Figure
            except ImportError:
                raise InputError(
                    "Plots need matplotlib: run pip install 'equimesh[plot]'."
                ) from None
            ax = Figure(layout="constrained").subplots()
        top = max(2.0, float(self.lengths.max(initial=0.0)))
        ax.hist(self.lengths, bins=np.linspace(0.0, top, 81), color=_INK)
        for end in _UNIT:
            ax.axvline(end, color=_ACCENT, linestyle=(0, (4, 2)), linewidth=1.2)
        ax.set_xlabel("metric length of an edge")
        ax.set_ylabel("edges")
        ax.set_title(f"{100.0 * self.share:.1f} % from 1/√2 to √2", loc="left", fontsize=11)
        return ax


def metric_profile(
    metric: Metric, points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> MetricProfile:
    """The profile of a mesh with points (n, 2) or (n, 3) and triangles (m, 3)."""
    plane = points[:, :2]
    ends = np.sort(np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    edges = np.unique(ends, axis=0)
    lengths = metric.lengths(plane[edges[:, 0]], plane[edges[:, 1]])
    corners = plane[triangles]
    mean = metric.means(corners)
    total = np.zeros(len(triangles))
    for i in range(3):
        d = corners[:, (i + 1) % 3] - corners[:, i]
        total += np.einsum("ni,nij,nj->n", d, mean, d)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    det = mean[:, 0, 0] * mean[:, 1, 1] - mean[:, 0, 1] ** 2
    qualities = 4.0 * math.sqrt(3.0) * area * np.sqrt(det) / total
    heights = points if points.shape[1] == 3 else np.column_stack([plane, np.zeros(len(plane))])
    off = 1.0 - qualities
    return MetricProfile(
        errors=off, bounds=off, points=heights, triangles=triangles, lengths=lengths,
        qualities=qualities,
    )  # fmt: skip
