"""A field as compiled kernels see it: arrays only.

Every kind of field answers the same four questions (``value``, ``gradient``, ``edge_error``,
``inner_error``) in a kernel module of its own; ``dispatch.py`` picks by ``kind``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.reference import by_reference

__all__ = ["PATCHES", "RASTER", "SURFACE", "KernelField"]

PATCHES, RASTER, SURFACE = 0, 1, 2


@by_reference
class KernelField(NamedTuple):
    """Arrays of a field in local coordinates; those that a kind does not use stay empty.

    Fields have the same types whatever the kind, so that every kernel compiles once.
    """

    kind: int
    # Scalars of the kind: origin and size of its index; for PATCHES also the share of the tolerance
    # that a vertex may take up where f is convex or concave, plus one (``two_sided``), the number
    # of leaves without a kink, and, where angles have a floor, the largest ratio of the lattice's
    # eigenvalues (``angled``).
    frame: NDArray[np.float64] = np.empty(0)
    grid: NDArray[np.float64] = np.empty((0, 0))  # RASTER: heights [row, column]
    child: NDArray[np.int32] = np.empty((0, 4), np.int32)  # PATCHES: quadtree
    coef: NDArray[np.float64] = np.empty((0, 0, 0))  # PATCHES: polynomials of the leaves
    kinks: NDArray[np.uint8] = np.empty(0, np.uint8)  # PATCHES: quadrants of a node with a kink
    points: NDArray[np.float64] = np.empty((0, 3))  # SURFACE: vertices
    triangles: NDArray[np.int32] = np.empty((0, 3), np.int32)  # SURFACE: triangles
    vertex_start: NDArray[np.int32] = np.empty(0, np.int32)  # SURFACE: cell -> its vertices (CSR)
    vertex_items: NDArray[np.int32] = np.empty(0, np.int32)
    triangle_start: NDArray[np.int32] = np.empty(0, np.int32)  # SURFACE: cell -> triangles over it
    triangle_items: NDArray[np.int32] = np.empty(0, np.int32)
    # Where angles have a floor (``optimise.angles``): its sine, and p, q, r with which (p x + q y,
    # r y) are the user's coordinates, turned; else empty.
    shape: NDArray[np.float64] = np.empty(0)
    sharp: NDArray[np.float64] = np.empty((0, 3))  # corners x, y by x, and the sine of their floor

    def two_sided(self) -> KernelField:
        """The same field for meshes whose vertices may leave it by up to the tolerance.

        Where it is convex or concave an edge may then have twice the interpolation error.
        """
        return self.relieved(2.0) if self.kind == PATCHES else self

    def relieved(self, share: float) -> KernelField:
        """The same field for lattices whose errors are ``share`` times larger where it is convex
        or concave."""
        frame = self.frame.copy()
        frame[3] *= share
        return self._replace(frame=frame)

    def angled(
        self, sine: float, matrix: NDArray[np.float64], sharp: NDArray[np.float64], ratio: float
    ) -> KernelField:
        """The same field for meshes whose angles have a floor.

        ``sine``: of the floor; ``matrix`` (2, 2): local to the user's coordinates; ``sharp``
        (k, 3): corners in local coordinates and the sine of the floor there; ``ratio``: by which
        the lattice's triangles are stretched, at most.
        """
        turned = np.linalg.qr(matrix, mode="r")
        turned *= np.sign(np.diag(turned))[:, None]
        frame = self.frame
        if self.kind == PATCHES:
            frame = np.append(frame, ratio * ratio)
        shape = np.array([sine, turned[0, 0], turned[0, 1], turned[1, 1]])
        order = np.argsort(sharp[:, 0], kind="stable")
        return self._replace(frame=frame, shape=shape, sharp=np.ascontiguousarray(sharp[order]))
