"""Errors of edges and triangles that cross a kink of a function.

Along a line the error has a peak wherever it crosses a kink, however narrow, so every leaf of the
quadtree that holds a piece of one is visited (``patches``), and nothing between them: a line steps
from cell to cell as large as they come (after Glassner, "Space subdivision for fast ray tracing",
1984). Inside a triangle lines parallel to its sides find the kink.
"""

from __future__ import annotations

import math

import numpy as np

from equimesh.fields import patch_kernels
from equimesh.fields.compiled import allocating, compiled
from equimesh.fields.patch_kernels import gradient, value

__all__ = ["edge_error", "inner_error", "sharpest"]

_LINES = 4  # parts of a triangle's height between lines parallel to a side
_PIECES = 16  # of kinks that a line looks at one by one; beyond them,
_STRIDE = 1.0 / 64.0  # of its length, it goes so far with each
_AHEAD = 1e-9  # of its length: beyond the end of a cell
_CORNER = 0.8  # of half a cell's side: where gradients on both sides of a kink are asked for


@compiled
def edge_error(F, ax, ay, az, bx, by, bz, stop):
    """Signed largest error on an edge and its parameter s; any error above ``stop`` will do."""
    e, s = patch_kernels.edge_error(F, ax, ay, az, bx, by, bz, stop)
    if F.kinks[0] > 0 and abs(e) <= stop:
        other, where = _on_line(F, ax, ay, az, bx, by, bz)
        if abs(other) > abs(e):
            return other, where
    return e, s


@compiled
def inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop):
    """Signed largest error inside a triangle and where; any above ``stop`` will do."""
    e, x, y = patch_kernels.inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop)
    if F.kinks[0] == 0 or abs(e) > stop:
        return e, x, y
    left, right = min(ax, bx, cx), max(ax, bx, cx)
    bottom, top = min(ay, by, cy), max(ay, by, cy)
    size = max(right - left, top - bottom)
    if not (
        _cell(F, left, bottom, size)[0]
        or _cell(F, right, bottom, size)[0]
        or _cell(F, left, top, size)[0]
        or _cell(F, right, top, size)[0]
    ):
        return e, x, y
    for _ in range(3):
        for k in range(1, _LINES):
            p, q = 1.0 - k / _LINES, k / _LINES
            ux, uy, uz = p * ax + q * cx, p * ay + q * cy, p * az + q * cz
            vx, vy, vz = p * bx + q * cx, p * by + q * cy, p * bz + q * cz
            other, s = _on_line(F, ux, uy, uz, vx, vy, vz)
            if abs(other) > abs(e):
                e, x, y = other, ux + s * (vx - ux), uy + s * (vy - uy)
        ax, ay, az, bx, by, bz, cx, cy, cz = bx, by, bz, cx, cy, cz, ax, ay, az
    return e, x, y


@compiled
def _cell(F, px, py, size):
    """Whether the smallest cell around a point that is not smaller than ``size`` has a kink; its
    corner and side, or those of the largest cell around the point that has none."""
    x, y, side, node = F.frame[0], F.frame[1], F.frame[2], 0
    if F.kinks[node] == 0:
        return False, x, y, side
    while node >= 0 and 0.5 * side >= size:
        side *= 0.5
        column, row = px >= x + side, py >= y + side
        x, y = x + side * column, y + side * row
        quadrant = column + 2 * row
        if (F.kinks[node] >> quadrant) & 1 == 0:
            return False, x, y, side
        node = F.child[node, quadrant]
    return True, x, y, side


@compiled
def _on_line(F, ax, ay, az, bx, by, bz):
    """Signed largest error where the line from a to b crosses kinks, and the share of the way."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    best, where, seen, s = 0.0, 0.5, 0, 0.0
    while s < 1.0:
        kink, x, y, side = _cell(F, ax + s * dx, ay + s * dy, 0.0)
        end = 1.0
        if dx != 0.0:
            end = min(end, ((x + side if dx > 0.0 else x) - ax) / dx)
        if dy != 0.0:
            end = min(end, ((y + side if dy > 0.0 else y) - ay) / dy)
        if kink:
            t = 0.5 * (s + max(end, s))
            e = value(F, ax + t * dx, ay + t * dy) - (az + t * dz)
            if abs(e) > abs(best):
                best, where = e, t
            seen += 1
        s = max(end + _AHEAD, s + (_STRIDE if kink and seen > _PIECES else _AHEAD))
    return best, where


@allocating
def sharpest(F):
    """About by how much the gradient jumps across the sharpest kink, and where; 0 without any."""
    places = np.zeros((F.child.shape[0], 2))
    sides = np.full(F.child.shape[0], F.frame[2])
    places[0] = F.frame[:2]
    jump, x, y = 0.0, 0.0, 0.0
    for node in range(F.child.shape[0]):  # those below a node have higher numbers
        side = 0.5 * sides[node]
        for quadrant in range(4):
            px = places[node, 0] + side * (quadrant % 2)
            py = places[node, 1] + side * (quadrant // 2)
            below = F.child[node, quadrant]
            if below > 0:
                places[below, 0], places[below, 1], sides[below] = px, py, side
            elif (F.kinks[node] >> quadrant) & 1:
                half = 0.5 * side
                cx, cy, off = px + half, py + half, _CORNER * half
                for dx, dy in ((off, off), (off, -off)):
                    ux, uy = gradient(F, cx + dx, cy + dy)
                    vx, vy = gradient(F, cx - dx, cy - dy)
                    if math.hypot(ux - vx, uy - vy) > jump:
                        jump, x, y = math.hypot(ux - vx, uy - vy), cx, cy
    return jump, x, y
