"""The region covered by the valid cells of a grid."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["cell_outline"]

Flags = NDArray[np.bool_]
Signs = NDArray[np.int8]
Segments = NDArray[np.float64]


def cell_outline(valid: Flags) -> shapely.Geometry:
    """The union of unit cells as a Polygon or MultiPolygon with holes, in (column, row) of nodes.

    ``valid`` (rows, columns) flags cells. Rings turn at every vertex (no collinear points); parts
    that meet at a corner only stay apart, as shapely's rules want them.
    """
    padded = np.pad(valid, 1).astype(np.int8)
    along_rows = _straight_runs(padded[1:, 1:-1] - padded[:-1, 1:-1])
    along_columns = _straight_runs((padded[1:-1, 1:] - padded[1:-1, :-1]).T)[:, :, ::-1]
    lines = shapely.linestrings(np.concatenate([along_rows, along_columns]))
    faces = shapely.get_parts(shapely.polygonize(lines))
    # the lines bound missing regions as well: keep the faces that lie over valid cells
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    column, row = np.clip(np.floor(inside).astype(np.int64), 0, np.array(valid.shape[::-1]) - 1).T
    kept = faces[valid[row, column]]
    return kept[0] if len(kept) == 1 else shapely.multipolygons(kept)


def _straight_runs(jump: Signs) -> Segments:
    """Maximal straight pieces of the border, (k, 2, 2) as ((column, row), (column, row)).

    ``jump[row, column]`` is the change of validity across the unit side from node (row, column) to
    (row, column + 1); a run ends where the jump does or changes sign (there four borders meet).
    """
    change = np.diff(np.pad(jump, ((0, 0), (1, 1))), axis=1) != 0
    before = np.pad(jump, ((0, 0), (1, 0))) != 0
    after = np.pad(jump, ((0, 0), (0, 1))) != 0
    start = np.argwhere(change & after)
    end = np.argwhere(change & before)
    return np.stack([start[:, ::-1], end[:, ::-1]], axis=1).astype(np.float64)
