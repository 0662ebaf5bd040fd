"""The first mesh: the transported lattice where the field is smooth, the bare outline elsewhere."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.boundary import boundary_nodes, side_nodes
from equimesh.domain import Sides
from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.frame import Frame
from equimesh.integrals import lattice_size
from equimesh.locality import curve_order
from equimesh.optimise.anneal import relief
from equimesh.optimise.mesh import FIXED, FREE, HEIGHTS, SLIDES, Mesh, build
from equimesh.optimise.sweep import step_aside
from equimesh.seeding import lattice_points
from equimesh.triangulation import constrained_delaunay

__all__ = [
    "Coarse", "FirstMesh", "aim_for", "coarse_mesh", "corners_suffice", "expected_triangles",
    "first_mesh", "heights_at",
]  # fmt: skip

# What triangles give away for safety, in units of the tolerance, is the less the smaller they are:
# between the lattice's errors, the optimiser's hinge, its aim and the tolerance itself.
_SLACK = 0.5  # over the square root of the number of triangles, at most
_MOST_SLACK = 0.015
_MARGIN = 0.05  # of it lies between the aim and the tolerance
_DATA_MARGIN = 3e-3  # and on data, in units of the tolerance
_SLACKS = (1.0, 0.6)  # how much of it lattices take in turn: with luck less is enough
_ROOM = 0.3  # share of spare slots where a lattice is laid
_ROWS = 20_000  # triangles of a lattice to be annealed, from which on saddles get rows first
_MOST = 2e7  # triangles that memory is meant to hold
_ALIKE = 1e-9  # of the domain's extent: coordinates that differ by rounding alone


class Coarse(NamedTuple):
    """A mesh of the corners and the constraints alone: (n, 2) local points, (m, 3) triangles."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FirstMesh:
    """A mesh in local coordinates with the sides of its domain.

    ``sides`` has the user's corners, directed as local coordinates see them. ``corner_of`` (n,)
    tells which of ``sides.vertices`` each first vertex is, -1 for none. ``settled``: no further
    vertex is needed. Vertices slide on rows of ``sides.segments``. ``aim``: the tolerance that the
    optimiser is to keep, a little below the one asked for. ``least``: about N*; 0 where no number
    of triangles is good enough, infinite where every one is.
    """

    mesh: Mesh
    sides: Sides
    corner_of: NDArray[np.int64]
    aim: float
    settled: bool = False
    least: float = 0.0


def first_mesh(
    surface: Field,
    kernel: KernelField,
    sides: Sides,
    frame: Frame,
    tol: float,
    error: float | None = None,
    two_sided: bool = False,
    turn: int = 0,
    expected: float | None = None,
    bare: bool = False,
) -> FirstMesh:
    """Vertices and triangles to start from, for a tolerance in units of z.

    ``error``: that of the lattice's triangles in units of the tolerance; None makes it a little
    less than the optimiser's hinge, so that they are left alone. ``two_sided``: vertices may leave
    the surface; where it is convex or concave they start beyond it (``kernel`` must know it).
    ``turn`` numbers lattices that start elsewhere, turned, with more or less to spare.
    ``expected``: what ``expected_triangles`` says, where it was asked already. ``bare``: the
    corners suffice, and no lattice is laid; nor is one on data.
    """
    laid = kernel.kind == PATCHES and not bare
    if laid and expected is None:
        expected = expected_triangles(kernel, coarse_mesh(sides, frame), tol)
    sides = _handed(sides, frame)
    local = _localised(sides, frame)
    ring = _corners_only(local)
    chains = _Chains(np.empty((0, 2)), sides.lines.edges, np.empty(0, np.int64))
    inner = np.empty((0, 2))
    slack, aim = _MOST_SLACK, tol * (1.0 - _DATA_MARGIN)
    if laid:
        assert expected is not None
        floor = _floor(local.corners)
        slack = _slack(expected) * _SLACKS[turn % len(_SLACKS)]
        reached = 1.0 - 1.2 * slack
        aim = tol * (1.0 - _MARGIN * slack)
        height = tol if error is None else tol * error / reached
        nodes = boundary_nodes(kernel, local, height, floor)
        corner = np.where(nodes.corner, nodes.side, -1)
        ring = _merged(nodes.points, nodes.following, nodes.side, corner)
        chains = _equidistributed(kernel, local, height, floor)
        relieved = kernel
        if error is not None:
            relieved = kernel.relieved(relief(error, two_sided, expected))
        inner = lattice_points(
            relieved, local, nodes, (reached if error is None else error) * aim, floor,
            int(expected) + 10,
            turn=turn, rows=error is not None and expected >= _ROWS,
            obstacles=chains.segments(local),
        )  # fmt: skip
    points, edges, walls = _outline(ring, local, chains)
    every = np.vstack([points, inner[curve_order(inner)]])
    triangles = constrained_delaunay(every, edges, walls)
    if len(inner):
        triangles = triangles[curve_order(every[triangles].mean(1))]
    b, n = len(ring.points), len(local.lines.nodes)
    corner_of = np.full(len(every), -1, np.int64)
    corner_of[:b] = ring.corner
    corner_of[b : b + n] = len(local.corners) + np.arange(n)
    kind = np.full(len(every), FREE, np.int8)
    kind[: len(points)] = np.where(corner_of[: len(points)] >= 0, FIXED, SLIDES)
    side_of = np.zeros(len(every), np.int64)
    side_of[:b] = ring.side
    side_of[b + n : len(points)] = len(local.corners) + chains.edge
    z = heights_at(surface, sides, frame, every, corner_of)
    mesh = build(
        np.column_stack([every, z]), triangles, kind, side_of, local.segments, walls,
        room=_ROOM if len(inner) else 1.0,
    )  # fmt: skip
    if two_sided:
        mesh.count[HEIGHTS] = 1
        if laid:
            step_aside(kernel, mesh, aim * (error or 1.0))
    if error is None:
        mesh.hinge[0] = 1.0 - slack
    return FirstMesh(mesh, sides, corner_of, aim, bare, expected or 0.0)


def heights_at(
    surface: Field,
    sides: Sides,
    frame: Frame,
    points: NDArray[np.float64],
    corner: NDArray[np.int64],
) -> NDArray[np.float64]:
    """(n,) heights at (n, 2) local points; those of ``sides.vertices`` (``corner``, -1: none) at
    the coordinates they were given."""
    user = frame.to_user(points)
    known = np.flatnonzero(corner >= 0)
    user[known] = sides.vertices[corner[known]]
    return np.asarray(surface.value(user[:, 0], user[:, 1]))


def coarse_mesh(sides: Sides, frame: Frame) -> Coarse:
    """What lattices are to fill, in as few triangles as there can be."""
    local = _localised(_handed(sides, frame), frame)
    chains = _Chains(np.empty((0, 2)), local.lines.edges, np.empty(0, np.int64))
    points, edges, walls = _outline(_corners_only(local), local, chains)
    return Coarse(points, constrained_delaunay(points, edges, walls))


def expected_triangles(kernel: KernelField, coarse: Coarse, tol: float) -> float:
    """About how many triangles a lattice over a smooth field has, for a tolerance in units of z.

    Raises InputError where they are more than memory is meant to hold.
    """
    expected = lattice_size(kernel, *coarse, tol, _floor(coarse.points))
    if expected > _MOST:
        raise InputError(
            f"The tolerance asks for about {expected:.1e} triangles: raise it, or mesh the domain "
            "in parts."
        )
    return expected


def corners_suffice(surface: Field, coarse: Coarse, frame: Frame, tol: float) -> bool:
    """Whether the coarse mesh is within the tolerance."""
    points = frame.to_user(coarse.points)
    corners = np.column_stack([points, surface.value(*points.T)])
    spots = corners[coarse.triangles]
    middles = np.concatenate([spots.mean(1), *(0.5 * (spots + spots[:, [1, 2, 0]]))])
    off = surface.value(middles[:, 0], middles[:, 1]) - middles[:, 2]
    if not (np.abs(off) <= tol).all():  # as nearly always
        return False
    _, bounds = surface.errors(corners, coarse.triangles, tol)
    return bool((bounds <= tol).all())


def aim_for(tol: float, triangles: float) -> float:
    """The tolerance that the optimiser of so many triangles is to keep."""
    return tol * (1.0 - _MARGIN * _slack(triangles))


def _slack(triangles: float) -> float:
    return min(_MOST_SLACK, _SLACK / math.sqrt(max(triangles, 1.0)))


def _floor(points: NDArray[np.float64]) -> float:
    """The least metric that lattices are laid in."""
    return 1.0 / float(np.ptp(points, axis=0).max()) ** 2


def _localised(sides: Sides, frame: Frame) -> Sides:
    """The sides in local coordinates."""
    lines = dataclasses.replace(sides.lines, nodes=frame.to_local(sides.lines.nodes))
    return dataclasses.replace(sides, corners=frame.to_local(sides.corners), lines=lines)


class _Ring(NamedTuple):
    """Boundary nodes: where, joined how, on which side, which corner (-1: none), and the place
    (k,) of every corner."""

    points: NDArray[np.float64]
    edges: NDArray[np.int64]
    side: NDArray[np.int64]
    corner: NDArray[np.int64]
    place: NDArray[np.int64]


class _Chains(NamedTuple):
    """Constraint lines cut by sliding nodes.

    ``points`` (c, 2) slide on ``edge`` (c,); ``walls`` (w, 2) number corners, nodes of the lines
    and then these.
    """

    points: NDArray[np.float64]
    walls: NDArray[np.int64]
    edge: NDArray[np.int64]

    def segments(self, local: Sides) -> NDArray[np.float64]:
        """(w + p, 4) walls and, as segments without length, points that no wall reaches."""
        vertices = np.vstack([local.vertices, self.points])
        alone = np.setdiff1d(np.arange(len(local.corners), len(vertices)), self.walls)
        ends = np.vstack([self.walls, np.stack([alone, alone], 1)])
        return np.asarray(vertices[ends].reshape(-1, 4))


def _equidistributed(kernel: KernelField, local: Sides, tol: float, floor: float) -> _Chains:
    """Nodes on every constraint line as on a side of the domain."""
    points, walls, owner = [np.empty((0, 2))], [np.empty((0, 2), np.int64)], []
    vertices = local.vertices
    count = len(vertices)
    for number, (a, b) in enumerate(local.lines.edges.tolist()):
        found = side_nodes(kernel, vertices[a], vertices[b], tol, floor)
        chain = np.concatenate([[a], count + np.arange(len(found)), [b]])
        points.append(found)
        walls.append(np.stack([chain[:-1], chain[1:]], 1))
        owner.append(np.full(len(found), number))
        count += len(found)
    return _Chains(np.vstack(points), np.vstack(walls), np.concatenate([np.empty(0, int), *owner]))


def _outline(
    ring: _Ring, local: Sides, chains: _Chains
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Points on the boundary and on constraints, boundary edges, and edges of constraints."""
    nodes = local.lines.nodes
    points = np.vstack([ring.points, nodes, chains.points])
    place = np.concatenate([ring.place, np.arange(len(ring.points), len(points))])
    return points, ring.edges, place[chains.walls]


def _handed(sides: Sides, frame: Frame) -> Sides:
    """The sides so directed that the domain is on their left in local coordinates."""
    if frame.determinant > 0.0:
        return sides
    before = np.empty_like(sides.following)
    before[sides.following] = np.arange(len(before))
    side, name = sides.lines.side_tags.T
    side_tags = np.stack([sides.following[side], name], 1)
    lines = dataclasses.replace(sides.lines, side_tags=side_tags)
    return Sides(sides.corners, before, sides.tags[before], sides.names, lines)


def _corners_only(sides: Sides) -> _Ring:
    n = np.arange(len(sides.corners))
    return _merged(sides.corners, sides.following, n, n)


def _merged(
    points: NDArray[np.float64],
    following: NDArray[np.int64],
    side: NDArray[np.int64],
    corner: NDArray[np.int64],
) -> _Ring:
    """Boundary nodes without duplicates (rings may touch in a corner) and their directed edges.

    They are numbered from left to right, wherever the rings begin.
    """
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    x, y = np.rint(points[first] / (_ALIKE * np.ptp(points, axis=0).max())).T
    rank = np.empty(len(first), np.int64)
    rank[np.lexsort([y, x])] = np.arange(len(first))
    order = np.empty_like(first)
    order[rank] = first
    index = rank[place.ravel()]
    edges = np.stack([index, index[following]], 1)
    return _Ring(points[order], edges, side[order], corner[order], index[corner >= 0])
