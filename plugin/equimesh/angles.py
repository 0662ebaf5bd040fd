"""A floor for the angles of a mesh: what is asked, where corners are sharper, what was reached."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from equimesh.angle_price import price_of_floor
from equimesh.domain import Sides
from equimesh.errors import InputError
from equimesh.fields.kernel import KernelField
from equimesh.frame import Frame
from equimesh.optimise.mesh import Mesh
from equimesh.profile import Profile

__all__ = ["AngleFloor", "checked_angle"]

Array = NDArray[np.float64]

MOST = 30.0  # degrees
_ABOVE = 1e-6  # what the optimiser keeps above the floor, as a share of it
_CORNER = 0.999  # of a sharp corner's own angle
# Equilateral triangles stretched by a ratio along one side keep angles of atan(sqrt 3 / ratio) on
# it; the lattice leaves these so much above the floor.
_ROOM = 1.15


@dataclass(frozen=True, eq=False)
class AngleFloor:
    """The smallest angle that triangles may have, seen from above, in degrees.

    ``corners`` (k, 2): the user's coordinates of vertices at which sides or constraints meet at a
    sharper angle; ``angles`` (k,) that angle, in degrees.
    """

    angle: float
    corners: Array
    angles: Array

    @classmethod
    def of(cls, angle: float, sides: Sides) -> AngleFloor:
        """The floor of a domain with its constraints."""
        corners, angles = _sectors(sides)
        sharp = angles < angle
        return cls(angle, corners[sharp], angles[sharp])

    def kept_by(self, kernel: KernelField, frame: Frame) -> KernelField:
        """The field whose meshes keep this floor."""
        floor = math.radians(self.angle) * (1.0 + _ABOVE)
        sines = np.sin(np.radians(self.angles * _CORNER))
        sharp = np.column_stack([frame.to_local(self.corners), sines])
        ratio = math.sqrt(3.0) / math.tan(_ROOM * floor)
        return kernel.angled(math.sin(floor), frame.matrix, sharp, ratio)

    def missed(self, points: Array, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Triangles (m, 3) with an angle below the floor; at a sharper corner that is its own."""
        floor = np.full(len(points), self.angle)
        if len(self.corners):
            order = np.lexsort(points[:, 1::-1].T)
            place = {
                tuple(p): i for i, p in zip(order.tolist(), points[order, :2].tolist(), strict=True)
            }
            for corner, angle in zip(self.corners.tolist(), self.angles.tolist(), strict=True):
                if tuple(corner) in place:
                    floor[place[tuple(corner)]] = _CORNER * angle * (1.0 - _ABOVE)
        below = np.zeros(len(triangles), bool)
        for k in range(3):
            a, b, c = (points[triangles[:, (k + i) % 3], :2] for i in range(3))
            u, v = b - a, c - a
            cross, dot = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(1)
            below |= np.degrees(np.arctan2(cross, dot)) < floor[triangles[:, k]]
        return np.flatnonzero(below)

    def note(self, profile: Profile, least: float, kernel: KernelField, mesh: Mesh) -> str:
        """The smallest angle that there is, and the price of the floor where theory tells it.

        ``least``: N* without the floor, nan where it means nothing.
        """
        said = f"min_angle={self.angle:g}: the smallest angle is {profile.angles.min():.2f} degrees"
        if not least > 0.0:
            return said
        live = mesh.tv[mesh.tv[:, 0] >= 0]
        price = price_of_floor(kernel, np.stack([mesh.x, mesh.y], 1), live, self.angle)
        return (
            f"{said}; it raises the fewest triangles from {least:,.0f} to {price * least:,.0f}, "
            f"and there are {len(profile.triangles):,}"
        )


def checked_angle(angle: object) -> float:
    """``min_angle=`` as degrees.

    Raises InputError where it is no number from 0 to 30.
    """
    try:
        value = float(angle)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = math.nan
    if isinstance(angle, bool) or not 0.0 < value <= MOST:
        raise InputError(
            f"min_angle={angle!r} cannot be kept: give degrees above 0 and at most {MOST:g}."
        )
    return value


def _sectors(sides: Sides) -> tuple[Array, Array]:
    """(k, 2) vertices where sides or constraints meet and (k,) the sharpest angle there."""
    vertices = sides.vertices
    own = np.arange(len(sides.corners))
    ends = np.vstack([np.stack([own, sides.following], 1), sides.lines.edges])
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    index = index.ravel()
    at = index[np.concatenate([ends[:, 0], ends[:, 1]])]
    step = vertices[ends[:, 1]] - vertices[ends[:, 0]]
    step = np.vstack([step, -step])
    # Counter-clockwise from a side that ends at a vertex lies what is outside.
    outside = np.zeros(len(at), bool)
    outside[len(ends) : len(ends) + len(own)] = True
    turn = np.arctan2(step[:, 1], step[:, 0])
    order = np.lexsort((turn, at))
    at, turn, outside = at[order], turn[order], outside[order]
    start = np.searchsorted(at, at, "left")
    stop = np.searchsorted(at, at, "right")
    following = np.where(np.arange(len(at)) + 1 < stop, np.arange(len(at)) + 1, start)
    sector = np.mod(turn[following] - turn, 2.0 * np.pi)
    sector[(stop - start == 1) | outside] = 2.0 * np.pi
    sharpest = np.full(len(places), 2.0 * np.pi)
    np.minimum.at(sharpest, at, sector)
    return places, np.degrees(sharpest)
