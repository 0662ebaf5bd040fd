"""Surfaces sampled on a grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import scipy
import shapely
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.kernel import RASTER, KernelField
from equimesh.fields.measures import border_heights, heights, triangle_errors
from equimesh.fields.raster_outline import cell_outline, simplified_outline
from equimesh.frame import Frame

__all__ = ["Border", "Bound", "Raster"]

Bound: TypeAlias = Literal["surface", "samples"]
Border: TypeAlias = Literal["simplified", "cells"]

_EPS = float(np.finfo(np.float64).eps)
_STEPS = 2.0**20
_LARGEST = 1e300  # differences of four samples must not overflow


@dataclass(frozen=True, eq=False)
class Raster:
    """The bilinear interpolant of samples at the nodes of a grid.

    A cell is the square between four neighbouring samples. It is valid where all four are there;
    the field is defined on the valid cells, their sides included. Local coordinates are (column,
    row) of the samples.

    Parameters
    ----------
    heights
        (rows, columns) real numbers of any type, masked entries allowed; rows run along y. Kept as
        float64 with NaN wherever a sample belongs to no valid cell.
    transform
        Six numbers (a, b, c, d, e, f) or a rasterio ``Affine``: sample (column, row) lies at
        x = a column + b row + c, y = d column + e row + f. Without it x = column and y = row.
        Raster files store the corner of the first pixel: shift by half a pixel for samples at
        pixel centres.
    nodata
        The value that marks missing samples, before scale and offset (NaN always does).
    metadata
        What a file says besides, such as its ``crs``; kept, not used.
    bound
        ``"surface"``: errors count everywhere on the bilinear surface. ``"samples"``: only at the
        samples; the mesh may do what it likes between them.
    border
        ``"simplified"``: the mesh ends on straight lines that run between valid and missing
        samples, with corners at valid ones. It covers every sample of a valid cell and no missing
        one, and parts of the cells between these, where errors do not count. ``"cells"``: it covers
        the valid cells and nothing else, a staircase.
    scale, offset
        Heights are ``scale`` times what is given plus ``offset``; both are applied once, and read 1
        and 0 afterwards.
    left_out
        Samples that were left out since they belong to no valid cell; counted here.

    Attributes
    ----------
    notes
        What was left out, in words.

    Raises
    ------
    InputError
        Not a 2-D array of real numbers, fewer than 2 x 2, infinite samples, no valid cell, or a
        transform that is not finite or flattens the grid.
    """

    heights: Array
    transform: tuple[float, ...] | None = None
    nodata: float | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    bound: Bound = "surface"
    border: Border = "simplified"
    scale: float = 1.0
    offset: float = 0.0
    left_out: int = 0
    notes: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        if self.bound not in get_args(Bound):
            raise InputError(f"The bound {self.bound!r} is unknown: choose surface or samples.")
        if self.border not in get_args(Border):
            raise InputError(f"The border {self.border!r} is unknown: choose simplified or cells.")
        units = _linear(self.scale, self.offset)
        heights, lost = _clean(self.heights, self.nodata, *units)
        kept: dict[str, Any] = {
            "transform": _six_numbers(self.transform),
            "heights": heights,
            "nodata": None,
            "scale": 1.0,
            "offset": 0.0,
            "left_out": self.left_out + lost,
            "notes": _notes(self.left_out + lost, self.bound),
        }
        for name, value in kept.items():
            object.__setattr__(self, name, value)
        _ = self._frame  # refuses a flat grid now rather than later

    def bounded(self, bound: Bound) -> Raster:
        """The same raster, its errors counted on the surface or at the samples."""
        return self if bound == self.bound else replace(self, bound=bound)

    def in_tolerances(self, tol: float) -> tuple[Raster, float]:
        """The same raster with heights counted from the lowest in units of ``tol``, and the lowest.

        Rounded to 2^-20, about a millionth of the tolerance: whatever the units of the heights,
        millimetres or feet, the numbers come out alike to the last bit, and so do decisions made on
        them. User's heights are ``lowest + tol * heights``.
        """
        low = self._range[0]
        heights = np.round((self.heights - low) / tol * _STEPS) / _STEPS
        return replace(self, heights=heights), low

    @property
    def size(self) -> str:
        """Such as ``344 x 403 samples``."""
        rows, columns = self.heights.shape
        return f"{rows} x {columns} samples"

    @cached_property
    def smooth(self) -> bool:
        """Whether cubics predict samples far better than straight lines do.

        Every sample is predicted from its neighbours at distance 1 and 3 along its row and along
        its column, by the cubic through them: (9 (h_-1 + h_1) - h_-3 - h_3) / 16, and by the mean
        of h_-1 and h_1. The errors are 3/8 h^4 f'''' and 1/2 h^2 f'' for a smooth f, but alike for
        noise and for rough terrain. Smooth: root mean squares in a ratio below 0.35 (measured:
        real terrain 0.8 to 1.0, Franke's function on 64 x 64 samples 0.04, with a kink 0.7).
        """
        cubic = linear = 0.0
        for h in (self.heights, self.heights.T):
            if h.shape[0] >= 7:
                near, far = h[2:-4] + h[4:-2], h[:-6] + h[6:]
                miss = h[3:-3] - (9.0 * near - far) / 16.0
                seen = np.isfinite(miss)
                cubic += float(np.sum(miss[seen] ** 2))
                linear += float(np.sum((h[3:-3] - 0.5 * near)[seen] ** 2))
        size = max(abs(bound) for bound in self._range)
        if linear <= self.heights.size * (8.0 * _EPS * size) ** 2:
            return bool(min(self.heights.shape) >= 7)  # a plane
        return cubic < 0.35**2 * linear

    def value(self, x: Array, y: Array) -> Array:
        """(n,) heights of the bilinear surface; NaN outside the valid cells."""
        return heights(self._kernel, self._local(x, y))

    def gradient(self, x: Array, y: Array) -> Array:
        """(n, 2) gradient of the bicubic spline through the samples.

        Finite everywhere: missing samples are filled from the nearest for the spline alone, and
        points outside the grid take the derivatives of its border.
        """
        column, row = self._local(x, y).T
        local = np.stack([self._spline(row, column, 0, 1), self._spline(row, column, 1, 0)], -1)
        return np.asarray(local @ np.linalg.inv(self._frame.matrix))

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives of the spline; see ``gradient``."""
        column, row = self._local(x, y).T
        local = np.zeros((len(row), 2, 2))
        local[:, 0, 0] = self._spline(row, column, 0, 2)
        local[:, 0, 1] = local[:, 1, 0] = self._spline(row, column, 1, 1)
        local[:, 1, 1] = self._spline(row, column, 2, 0)
        inverse = np.linalg.inv(self._frame.matrix)
        return np.asarray(inverse.T @ local @ inverse)

    def outline(self, tol: float = 0.0) -> shapely.Geometry:
        """The region to mesh, see ``border``; the union of the valid cells where ``tol`` is 0."""
        return self._simplified if tol > 0.0 and self.border == "simplified" else self._cells

    def span(self, domain: shapely.Geometry) -> tuple[float, float]:
        """Extremes of the bilinear surface over the domain: at samples inside and on its border."""
        local = self._frame.geometry_to_local(domain)
        low, high = self._range
        rows, columns = self.heights.shape
        xmin, ymin, xmax, ymax = shapely.bounds(local)
        column = np.arange(max(math.ceil(xmin), 0), min(math.floor(xmax), columns - 1) + 1)
        row = np.arange(max(math.ceil(ymin), 0), min(math.floor(ymax), rows - 1) + 1)
        samples = self.heights[np.ix_(row, column)]
        shapely.prepare(local)
        samples = samples[shapely.contains_xy(local, *np.meshgrid(column, row))]
        border = border_heights(self._kernel, local, low, high)
        reached = np.concatenate([samples[np.isfinite(samples)], border])
        if not len(reached):
            raise InputError("The domain meets no valid cell of the raster: check its coordinates.")
        return float(reached.min()), float(reached.max())

    def frame(self, domain: shapely.Geometry | None = None) -> Frame:
        """(column, row) of the nodes, whatever the domain."""
        return self._frame

    def kernel(self, domain: shapely.Geometry | None = None, tol: float = 0.0) -> KernelField:
        """The samples for compiled kernels; the same for every domain and tolerance."""
        if self.bound == "surface":
            return self._kernel
        return self._kernel._replace(frame=np.array([self._slack, 1.0]))

    def errors(
        self, points: Array, triangles: IntArray, limit: float = np.inf
    ) -> tuple[Array, Array]:
        """(m,) largest |bilinear surface - triangle| on each triangle, and (m,) bounds.

        Anywhere, or at the samples: see ``bound``. Exact up to rounding, vertices off the surface
        included; what lies over no valid cell is ignored. The bounds add the rounding of heights
        and of coordinates.
        """
        points = np.asarray(points, np.float64)
        local = np.column_stack([self._frame.to_local(points[:, :2]), points[:, 2]])
        errors = triangle_errors(self.kernel(), local, triangles)
        size = np.abs(self._range).max() + np.abs(points[triangles, 2]).max(axis=1, initial=0.0)
        return errors, errors * (1.0 + 1e-12) + 16.0 * _EPS * size + self._slack * self._steepest

    @cached_property
    def _frame(self) -> Frame:
        a, b, c, d, e, f = _six_numbers(self.transform)
        frame = Frame(np.array([c, f]), np.array([[a, b], [d, e]]))
        return replace(frame, snap=self._rounding(frame))

    @cached_property
    def _range(self) -> tuple[float, float]:
        return float(np.nanmin(self.heights)), float(np.nanmax(self.heights))

    @property
    def _slack(self) -> float:
        return self._frame.snap

    def _rounding(self, frame: Frame) -> float:
        """Rounding, in cells, of a point carried from the user's coordinates to local ones."""
        corners = np.array([[0.0, 0.0], self.heights.shape[::-1]])
        size = np.abs(frame.to_user(corners)).max() + np.abs(frame.origin).max()
        cell = np.abs(np.linalg.inv(frame.matrix)).sum(axis=1).max()
        return min(float(8.0 * _EPS * (size * cell + max(self.heights.shape))), 0.25)

    @cached_property
    def _steepest(self) -> float:
        """Twice the largest difference of neighbours, which bounds the slope per cell."""
        along = [np.abs(np.diff(self.heights, axis=k)) for k in (0, 1)]
        return 2.0 * max(float(np.nanmax(d, initial=0.0, where=np.isfinite(d))) for d in along)

    @cached_property
    def _kernel(self) -> KernelField:
        return KernelField(RASTER, frame=np.array([self._slack, 0.0]), grid=self.heights)

    @cached_property
    def _cells(self) -> shapely.Geometry:
        return shapely.transform(cell_outline(_valid_cells(self.heights)), self._frame.to_user)

    @cached_property
    def _simplified(self) -> shapely.Geometry:
        if not np.isnan(self.heights).any():
            return self._cells
        local = cell_outline(_valid_cells(self.heights))
        missing = np.isnan(self.heights)
        return shapely.transform(simplified_outline(local, missing), self._frame.to_user)

    @cached_property
    def _fit(self) -> scipy.interpolate.RectBivariateSpline:
        """The C2 bicubic spline over (row, column)."""
        heights = self.heights
        missing = np.isnan(heights)
        if missing.any():
            nearest = scipy.ndimage.distance_transform_edt(
                missing, return_distances=False, return_indices=True
            )
            heights = heights[tuple(nearest)]
        (row, by_row), (column, by_column) = (_four_nodes(count) for count in heights.shape)
        return scipy.interpolate.RectBivariateSpline(
            row, column, by_row @ heights @ by_column.T, s=0
        )

    def _spline(self, row: Array, column: Array, down: int, across: int) -> Array:
        return np.asarray(self._fit.ev(row, column, dx=down, dy=across))

    def _local(self, x: Array, y: Array) -> Array:
        points = np.stack(np.broadcast_arrays(x, y), axis=-1).astype(np.float64)
        return np.ascontiguousarray(self._frame.to_local(points.reshape(-1, 2)))


def _four_nodes(count: int) -> tuple[Array, Any]:
    """Nodes for a cubic spline and the matrix that takes samples there.

    Two or three samples are carried by their polynomial to four nodes; more stay where they are.
    """
    at = np.arange(count, dtype=np.float64)
    if count >= 4:
        return at, scipy.sparse.eye_array(count)
    nodes = np.linspace(0.0, count - 1.0, 4)
    return nodes, np.vander(nodes, count) @ np.linalg.inv(np.vander(at, count))


def _six_numbers(transform: Sequence[float] | None) -> tuple[float, ...]:
    if transform is None:
        return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    try:
        numbers = tuple(float(number) for number in transform)
    except (TypeError, ValueError):
        numbers = ()
    if numbers[6:] == (0.0, 0.0, 1.0):  # the last row of an Affine
        numbers = numbers[:6]
    if len(numbers) != 6:
        raise InputError(
            "The transform is not six numbers: give (a, b, c, d, e, f) with "
            "x = a column + b row + c and y = d column + e row + f."
        )
    return numbers


def _linear(scale: float, offset: float) -> tuple[float, float]:
    try:
        numbers = float(scale), float(offset)
    except (TypeError, ValueError):
        numbers = math.nan, math.nan
    if not all(map(math.isfinite, numbers)) or numbers[0] == 0.0:
        raise InputError(
            f"Heights with scale {scale!r} and offset {offset!r} make no sense: give finite "
            "numbers, the scale not zero."
        )
    return numbers


def _notes(lost: int, bound: Bound) -> tuple[str, ...]:
    notes = []
    if lost:
        plural = "s that belong" if lost > 1 else " that belongs"
        notes.append(f"left out {lost:,} sample{plural} to no cell with four samples")
    if bound == "samples":
        notes.append("errors are bounded at the samples only, not between them")
    return tuple(notes)


def _valid_cells(heights: Array) -> NDArray[np.bool_]:
    """(rows - 1, columns - 1) whether all four samples of a cell are there."""
    sample = np.isfinite(heights)
    return np.asarray(sample[:-1, :-1] & sample[:-1, 1:] & sample[1:, :-1] & sample[1:, 1:])


def _clean(
    heights: ArrayLike, nodata: float | None, scale: float, offset: float
) -> tuple[Array, int]:
    """(rows, columns) float64, C-contiguous, NaN where a sample belongs to no valid cell.

    Also the number of samples that are there but belong to none.
    """
    given: Any = np.ma.asanyarray(heights)
    if given.dtype.kind not in "iuf":
        raise InputError(
            f"The raster holds {given.dtype} values: give an array of integers or real numbers."
        )
    if given.ndim != 2 or min(given.shape) < 2:
        raise InputError(
            f"The raster has shape {given.shape}: give a 2-D array of at least 2 x 2 samples."
        )
    missing = np.ma.getmaskarray(given)
    data = np.ma.getdata(given)
    if nodata is not None:
        missing = missing | (data == nodata)
    out = data.astype(np.float64)  # a copy
    if scale != 1.0 or offset != 0.0:
        with np.errstate(over="ignore"):
            out = scale * out + offset
    out[missing] = np.nan
    if (np.abs(out) > _LARGEST).any():
        raise InputError(
            "The raster has infinite samples: replace them, or mark them with NaN or nodata=."
        )
    if not np.isnan(out).any():
        return np.ascontiguousarray(out), 0
    cell = _valid_cells(out)
    if not cell.any():
        raise InputError(
            "The raster has no valid cell: at least one cell needs its four corner samples."
        )
    padded = np.pad(cell, 1)
    used = padded[:-1, :-1] | padded[:-1, 1:] | padded[1:, :-1] | padded[1:, 1:]
    lost = int(np.count_nonzero(~np.isnan(out) & ~used))
    out[~used] = np.nan
    return np.ascontiguousarray(out), lost
