"""What is near in the plane shall be near in memory: large meshes are worked on faster."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["curve_order"]

_BITS = 16  # of each coordinate


def curve_order(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) order of (n, 2) points along a Z-curve (Morton 1966): the bits of x and y in turn."""
    if len(points) == 0:
        return np.empty(0, np.int64)
    low = points.min(0)
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    cells = ((points - low) / extent * (2**_BITS - 1)).astype(np.uint64)
    key = _spread(cells[:, 0]) | (_spread(cells[:, 1]) << np.uint64(1))
    return np.argsort(key, kind="stable")


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A zero after every bit of numbers below 2^16."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits
