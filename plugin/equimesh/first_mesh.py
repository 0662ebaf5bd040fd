"""The first mesh: the transported lattice where the field is smooth, the bare outline elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from equimesh.boundary import boundary_nodes
from equimesh.domain import Sides
from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.frame import Frame
from equimesh.metric import lattice_size
from equimesh.optimise.mesh import FIXED, FREE, HEIGHTS, SLIDES, Mesh, build
from equimesh.optimise.sweep import step_aside
from equimesh.seeding import lattice_points
from equimesh.triangulation import constrained_delaunay

__all__ = ["SETTLED", "FirstMesh", "first_mesh"]

# Lattice triangles just below the optimiser's hinge, so that it leaves them alone.
SETTLED = 0.982
_MOST = 2e7  # triangles that memory is meant to hold


@dataclass(frozen=True, eq=False)
class FirstMesh:
    """A mesh in local coordinates with the sides of its domain.

    ``sides`` has the user's corners, directed as local coordinates see them. ``corner_of`` (n,)
    tells which corner each first vertex is, -1 for none. ``settled``: no vertex but the corners is
    needed.
    """

    mesh: Mesh
    sides: Sides
    corner_of: NDArray[np.int64]
    settled: bool = False


def first_mesh(
    surface: Field,
    kernel: KernelField,
    sides: Sides,
    frame: Frame,
    tol: float,
    error: float = SETTLED,
    two_sided: bool = False,
    turn: int = 0,
) -> FirstMesh:
    """Vertices and triangles to start from, for a tolerance in units of z.

    ``error``: that of the lattice's triangles in units of the tolerance. ``two_sided``: vertices
    may leave the surface; where it is convex or concave they start beyond it (``kernel`` must know
    it). ``turn`` numbers lattices that start elsewhere and turned.
    """
    sides = _handed(sides, frame)
    local = Sides(frame.to_local(sides.corners), sides.following, sides.tags, sides.names)
    segments = np.hstack([local.corners, local.corners[local.following]])
    points, edges, side, corner_of = _corners_only(local)
    inner = np.empty((0, 2))
    settled = kernel.kind == PATCHES and _coarse_is_enough(surface, sides, tol)
    if kernel.kind == PATCHES and not settled:
        coarse = constrained_delaunay(points, edges)
        extent = float(np.ptp(local.corners, axis=0).max())
        floor = 1.0 / extent**2
        expected = lattice_size(kernel, points, coarse, tol, floor)
        if expected > _MOST:
            raise InputError(
                f"The tolerance asks for about {expected:.1e} triangles: raise it, or mesh the "
                "domain in parts."
            )
        nodes = boundary_nodes(kernel, local, tol * error / SETTLED, floor)
        inner = lattice_points(
            kernel, local, nodes, error * tol, floor, int(expected) + 10, turn=turn
        )
        corner = np.where(nodes.corner, nodes.side, -1)
        points, edges, side, corner_of = _merged(nodes.points, nodes.following, nodes.side, corner)
    every = np.vstack([points, inner])
    triangles = constrained_delaunay(every, edges)
    kind = np.full(len(every), FREE, np.int8)
    kind[: len(points)] = np.where(corner_of >= 0, FIXED, SLIDES)
    side_of = np.zeros(len(every), np.int64)
    side_of[: len(points)] = side
    user = frame.to_user(every)
    known = np.flatnonzero(corner_of >= 0)
    user[known] = sides.corners[corner_of[known]]
    z = surface.value(user[:, 0], user[:, 1])
    mesh = build(np.column_stack([every, z]), triangles, kind, side_of, segments)
    if two_sided:
        mesh.count[HEIGHTS] = 1
        if kernel.kind == PATCHES and not settled:
            step_aside(kernel, mesh, tol * error)
    return FirstMesh(mesh, sides, corner_of, settled)


def _coarse_is_enough(surface: Field, sides: Sides, tol: float) -> bool:
    """Whether the domain's corners alone make a mesh within the tolerance."""
    points, edges, _, _ = _corners_only(sides)
    triangles = constrained_delaunay(points, edges)
    z = surface.value(points[:, 0], points[:, 1])
    _, bounds = surface.errors(np.column_stack([points, z]), triangles, tol)
    return bool((bounds <= tol).all())


def _handed(sides: Sides, frame: Frame) -> Sides:
    """The sides so directed that the domain is on their left in local coordinates."""
    if frame.determinant > 0.0:
        return sides
    before = np.empty_like(sides.following)
    before[sides.following] = np.arange(len(before))
    return Sides(sides.corners, before, sides.tags[before], sides.names)


def _corners_only(
    sides: Sides,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    n = np.arange(len(sides.corners))
    return _merged(sides.corners, sides.following, n, n)


def _merged(
    points: NDArray[np.float64],
    following: NDArray[np.int64],
    side: NDArray[np.int64],
    corner: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Boundary nodes without duplicates (rings may touch in a corner) and their directed edges."""
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.sort(first)
    index = np.searchsorted(order, first)[place.ravel()]
    edges = np.stack([index, index[following]], 1)
    return points[order], edges, side[order], corner[order]
