"""The region covered by the valid cells of a grid, as a staircase or with straight sides."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating

__all__ = ["cell_outline", "simplified_outline"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
IntArray = NDArray[np.int64]
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


def simplified_outline(staircase: shapely.Geometry, missing: Flags) -> shapely.Geometry:
    """Straight sides between samples of the staircase, with few corners.

    The region holds all of the staircase's region and no missing sample: it grows by parts of the
    cells that lie between these. Rings are shortened one by one; those that would then cross or
    touch others anew keep their stairs.

    Parameters
    ----------
    staircase
        What ``cell_outline`` returns.
    missing
        (rows, columns) flags of samples.
    """
    parts = shapely.get_parts(shapely.orient_polygons(staircase))
    rings, part = shapely.get_rings(parts, return_index=True)
    old = [shapely.get_coordinates(ring)[:-1].astype(np.int64) for ring in rings]
    new = [_shortened(corners, missing) for corners in old]
    for _ in range(len(rings)):
        outline = _polygons(new, part)
        blame = _entangled(outline, new, len(parts))
        if not len(blame):
            return outline
        for k in blame:
            new[k] = old[k]
    return staircase


def _polygons(rings: list[IntArray], part: IntArray) -> shapely.Geometry:
    number = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    lines = shapely.linearrings(np.concatenate(rings).astype(np.float64), indices=number)
    first = np.flatnonzero(np.diff(part, prepend=-1))
    last = np.append(first[1:], len(rings))
    made = [shapely.Polygon(lines[i], lines[i + 1 : j]) for i, j in zip(first, last, strict=True)]
    return made[0] if len(made) == 1 else shapely.multipolygons(made)


def _entangled(outline: shapely.Geometry, rings: list[IntArray], parts: int) -> IntArray:
    """Numbers of the rings whose new sides get in the way of others; none in a valid outline."""
    if outline.is_valid and len(shapely.get_parts(outline)) == parts:
        return np.zeros(0, np.int64)
    number = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    sides = shapely.linestrings(np.stack([start, end], axis=1).astype(np.float64))
    i, j = shapely.STRtree(sides).query(sides, "intersects")
    joined = (start[i] == end[j]).all(axis=1) | (end[i] == start[j]).all(axis=1)
    meet = (start[i] == start[j]).all(axis=1)
    crossed = (i != j) & ~joined & ~meet
    found = np.unique(number[i[crossed]])
    return found if len(found) else np.arange(len(rings))


def _shortened(corners: IntArray, missing: Flags) -> IntArray:
    """Corners to keep of a closed staircase (k, 2), the region on its left."""
    following = np.roll(corners, -1, axis=0)
    step = np.sign(following - corners)
    count = np.abs(following - corners).sum(axis=1)
    owner = np.repeat(np.arange(len(corners)), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    chain = corners[owner] + place[:, None] * step[owner]
    # the first is a corner of the convex hull: no side passes it by
    first = int(np.lexsort((chain[:, 1], chain[:, 0]))[0])
    chain = np.vstack([np.roll(chain, -first, axis=0), chain[first]])
    kept = chain[_long_sides(np.ascontiguousarray(chain), missing)]
    before, after = kept - np.roll(kept, 1, axis=0), np.roll(kept, -1, axis=0) - kept
    straight = before[:, 0] * after[:, 1] == before[:, 1] * after[:, 0]
    return np.asarray(kept[~straight] if np.count_nonzero(~straight) >= 3 else corners)


@allocating
def _long_sides(chain: IntArray, missing: Flags) -> IntArray:
    """Places in a closed chain of neighbouring samples (n + 1, 2), the last its first, to keep.

    From each sample the side goes to the last sample ahead for which all those between lie on it or
    on its left, and the missing ones beside them on its right: a wedge of directions that every
    step makes narrower.
    """
    rows, columns = missing.shape
    last = len(chain) - 1
    kept = np.empty(last, np.int64)
    found = 0
    at = 0
    while at < last:
        kept[found] = at
        found += 1
        x, y = chain[at]
        # directions on the left of (rx, ry), and on or right of (lx, ly)
        lx, ly = chain[at + 1, 0] - x, chain[at + 1, 1] - y
        rx, ry = ly, -lx
        reached = at + 1
        for k in range(at + 1, last + 1):
            dx, dy = chain[k, 0] - chain[k - 1, 0], chain[k, 1] - chain[k - 1, 1]
            empty = False
            for end in (k - 1, k):
                column, row = chain[end, 0] + dy, chain[end, 1] - dx  # on the right of the step
                outside = column < 0 or row < 0 or column >= columns or row >= rows
                if outside or missing[row, column]:
                    qx, qy = column - x, row - y
                    if qx * ly - qy * lx <= 0:
                        empty = True
                    elif rx * qy - ry * qx > 0:
                        rx, ry = qx, qy
            px, py = chain[k, 0] - x, chain[k, 1] - y
            from_left, from_right = lx * py - ly * px, rx * py - ry * px
            if from_left < 0 and from_right > 0:
                lx, ly = px, py
            elif from_left < 0 or from_right < 0:
                empty = True
            if empty:
                break
            if px * ly - py * lx >= 0 and from_right > 0:
                reached = k
        at = reached
    return kept[:found]


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
