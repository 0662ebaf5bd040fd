"""Conjugate gradients on a matrix of 2 x 2 blocks: one for each vertex and one for each edge.

The diagonal is damped after Levenberg and Marquardt, and the vertices' own blocks precondition.
"""

from __future__ import annotations

from equimesh.fields.compiled import compiled

__all__ = ["solve"]

_CONJUGATE = 60  # conjugate gradients for one step,
_SMALL = 1e-4  # or as many as bring the square of the residual down to this share


@compiled
def _times(diagonal, beside, ends, damping, x, out):
    """``out`` = the damped matrix times x."""
    more = 1.0 + damping
    for v in range(x.shape[0]):
        out[v, 0] = more * diagonal[v, 0] * x[v, 0] + diagonal[v, 1] * x[v, 1]
        out[v, 1] = diagonal[v, 1] * x[v, 0] + more * diagonal[v, 2] * x[v, 1]
    for n in range(ends.shape[0]):
        a, b = ends[n, 0], ends[n, 1]
        out[a, 0] += beside[n, 0] * x[b, 0] + beside[n, 1] * x[b, 1]
        out[a, 1] += beside[n, 2] * x[b, 0] + beside[n, 3] * x[b, 1]
        out[b, 0] += beside[n, 0] * x[a, 0] + beside[n, 2] * x[a, 1]
        out[b, 1] += beside[n, 1] * x[a, 0] + beside[n, 3] * x[a, 1]


@compiled
def _precondition(diagonal, damping, r, out):
    """Divide by the vertices' own blocks; what has none (fixed, gone) stays."""
    for v in range(r.shape[0]):
        a, b, c = (1.0 + damping) * diagonal[v, 0], diagonal[v, 1], (1.0 + damping) * diagonal[v, 2]
        least = 1e-9 * (a + c)
        a, c = a + least, c + least
        det = a * c - b * b
        if det > 0.0:
            out[v, 0], out[v, 1] = (
                (c * r[v, 0] - b * r[v, 1]) / det,
                (a * r[v, 1] - b * r[v, 0]) / det,
            )
        else:
            out[v, 0] = out[v, 1] = 0.0


@compiled
def _dot(x, y):
    total = 0.0
    for v in range(x.shape[0]):
        total += x[v, 0] * y[v, 0] + x[v, 1] * y[v, 1]
    return total


@compiled
def solve(diagonal, beside, ends, damping, downhill, step, work):
    """Conjugate gradients for the damped step; ``work`` (4, v, 2)."""
    r, z, d, q = work[0], work[1], work[2], work[3]
    for v in range(step.shape[0]):
        for i in range(2):
            step[v, i], r[v, i] = 0.0, downhill[v, i]
    _precondition(diagonal, damping, r, z)
    for v in range(step.shape[0]):
        d[v, 0], d[v, 1] = z[v, 0], z[v, 1]
    rz = first = _dot(r, z)
    for _ in range(_CONJUGATE):
        if not rz > _SMALL * first:
            break
        _times(diagonal, beside, ends, damping, d, q)
        dq = _dot(d, q)
        if not dq > 0.0:
            break
        length = rz / dq
        for v in range(step.shape[0]):
            for i in range(2):
                step[v, i] += length * d[v, i]
                r[v, i] -= length * q[v, i]
        _precondition(diagonal, damping, r, z)
        before, rz = rz, _dot(r, z)
        for v in range(step.shape[0]):
            for i in range(2):
                d[v, i] = z[v, i] + rz / before * d[v, i]
