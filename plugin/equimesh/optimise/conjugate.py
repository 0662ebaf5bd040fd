"""Conjugate gradients on a matrix of 2 x 2 blocks: one for each vertex and one for each edge.

The diagonal is damped after Levenberg and Marquardt, and the vertices' own blocks precondition.
Each vertex gathers its row from the edges around it, so that rows may be shared by threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.reference import by_reference
from equimesh.fields.workers import in_ranges

__all__ = ["Matrix", "matrix", "solve", "solve_alone"]

_CONJUGATE = 60  # conjugate gradients for one step, at most
_MANY = 16_000  # vertices from which on threads share the rows,
_ROWS = 4096  # so many at a time


@by_reference
class Matrix(NamedTuple):
    """Blocks of a symmetric matrix, row by row."""

    diagonal: NDArray[np.float64]  # (v, 3) xx, xy, yy
    first: NDArray[np.int64]  # (v + 1,) bounds of each vertex's part of the next two
    beyond: NDArray[np.int32]  # (2 e,) the other ends of its edges
    blocks: NDArray[np.float64]  # (2 e, 4) xx, xy, yx, yy
    places: NDArray[np.int32]  # (e, 2) where each edge's first and second end have it


def matrix(vertices: int, ends: NDArray[np.int64]) -> Matrix:
    """A matrix of zeros for a mesh of so many vertices with the edges ``ends`` (e, 2)."""
    first = np.zeros(vertices + 1, np.int64)
    np.cumsum(np.bincount(ends.ravel(), minlength=vertices), out=first[1:])
    beyond, places = np.zeros(2 * len(ends), np.int32), np.zeros((len(ends), 2), np.int32)
    _list_edges(ends, first[:-1].copy(), beyond, places)
    return Matrix(np.zeros((vertices, 3)), first, beyond, np.zeros((2 * len(ends), 4)), places)


@compiled
def _list_edges(ends, free, beyond, places):
    """The edges at each vertex; ``free`` (v,) is where its part begins, and written over."""
    for n in range(ends.shape[0]):
        for k in range(2):
            v = ends[n, k]
            beyond[free[v]] = ends[n, 1 - k]
            places[n, k] = free[v]
            free[v] += 1


@compiled
def _multiply(of, damping, d, q, start, stop):
    """Rows ``start`` ... ``stop`` of the damped matrix times d, into q; returns their part of
    d q."""
    more, total = 1.0 + damping, 0.0
    for v in range(start, stop):
        x, y = d[v, 0], d[v, 1]
        qx = more * of.diagonal[v, 0] * x + of.diagonal[v, 1] * y
        qy = of.diagonal[v, 1] * x + more * of.diagonal[v, 2] * y
        for i in range(of.first[v], of.first[v + 1]):
            w, block = of.beyond[i], of.blocks[i]
            qx += block[0] * d[w, 0] + block[1] * d[w, 1]
            qy += block[2] * d[w, 0] + block[3] * d[w, 1]
        q[v, 0], q[v, 1] = qx, qy
        total += x * qx + y * qy
    return total


@compiled
def _advance(of, damping, length, d, q, step, r, z, start, stop):
    """A step of this length along d; the residual r, divided by the vertices' own blocks, is z.

    What has no block (fixed, gone) stays. Returns the rows' part of r z.
    """
    more, total = 1.0 + damping, 0.0
    for v in range(start, stop):
        for i in range(2):
            step[v, i] += length * d[v, i]
            r[v, i] -= length * q[v, i]
        a, b, c = more * of.diagonal[v, 0], of.diagonal[v, 1], more * of.diagonal[v, 2]
        least = 1e-9 * (a + c)
        a, c = a + least, c + least
        det = a * c - b * b
        z[v, 0] = z[v, 1] = 0.0
        if det > 0.0:
            z[v, 0] = (c * r[v, 0] - b * r[v, 1]) / det
            z[v, 1] = (a * r[v, 1] - b * r[v, 0]) / det
        total += r[v, 0] * z[v, 0] + r[v, 1] * z[v, 1]
    return total


@compiled
def _turn(z, share, d, start, stop):
    """The next direction."""
    for v in range(start, stop):
        for i in range(2):
            d[v, i] = z[v, i] + share * d[v, i]


@compiled
def solve_alone(of, damping, downhill, step, work, left):
    """``solve`` in one thread: on a small mesh Python between the kernels would take longer than
    they do."""
    n = step.shape[0]
    d, q, z, r = work[0], work[1], work[2], work[3]
    for v in range(n):
        for i in range(2):
            step[v, i] = d[v, i] = q[v, i] = 0.0
            r[v, i] = downhill[v, i]
    rz = least = _advance(of, damping, 0.0, d, q, step, r, z, 0, n)
    least *= left
    _turn(z, 0.0, d, 0, n)
    for _ in range(_CONJUGATE):
        if not rz > least:
            break
        dq = _multiply(of, damping, d, q, 0, n)
        if not dq > 0.0:
            break
        before, rz = rz, _advance(of, damping, rz / dq, d, q, step, r, z, 0, n)
        _turn(z, rz / before, d, 0, n)


def _shared(work: Callable[[int, int], None], count: int, parts: NDArray[np.float64]) -> float:
    """The sum of what ``work`` has left in ``parts`` for each range of rows."""
    in_ranges(work, count, _ROWS)
    return float(parts.sum())


def solve(
    of: Matrix,
    damping: float,
    downhill: NDArray[np.float64],
    step: NDArray[np.float64],
    work: NDArray[np.float64],
    left: float,
) -> None:
    """The damped ``step`` (v, 2) for the negative gradient ``downhill`` (v, 2).

    Until this share of the square of the residual is ``left``, measured by the vertices' own
    blocks. ``work`` (4, v, 2) is scratch.
    """
    n = len(step)
    if n < _MANY:
        solve_alone(of, damping, downhill, step, work, left)
        return
    d, q, z, r = work
    step[:], d[:], q[:], r[:] = 0.0, 0.0, 0.0, downhill
    parts = np.zeros(-(-n // _ROWS))

    def product(start: int, stop: int) -> None:
        parts[start // _ROWS] = _multiply(of, damping, d, q, start, stop)

    def advanced(length: float) -> float:
        def work(start: int, stop: int) -> None:
            parts[start // _ROWS] = _advance(of, damping, length, d, q, step, r, z, start, stop)

        return _shared(work, n, parts)

    def turned(share: float) -> None:
        in_ranges(lambda start, stop: _turn(z, share, d, start, stop), n, _ROWS)

    rz = advanced(0.0)
    least, share = left * rz, 0.0
    for _ in range(_CONJUGATE):
        turned(share)
        if not rz > least:
            break
        dq = _shared(product, n, parts)
        if not dq > 0.0:
            break
        before, rz = rz, advanced(rz / dq)
        share = rz / before
