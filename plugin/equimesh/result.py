"""What ``remesh`` gives back."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from equimesh.profile import Profile

__all__ = ["Boundary", "Constraints", "Result", "Status"]


class Status(enum.Enum):
    """How a run ended; the text tells the cause and the remedy."""

    CONVERGED = "the error is certified to be at most the tolerance everywhere"
    NOT_CONVERGED = (
        "the error exceeds the tolerance in places: the surface may have a jump or finer detail "
        "than double precision resolves there; raise the tolerance or cut the domain along the jump"
    )
    LIMITED = (
        "the number of triangles ended the run before the tolerance that was asked for: the error "
        "is certified to be at most the larger one that the result tells; allow more triangles or "
        "raise the tolerance"
    )
    SHARP = (
        "the error is certified to be at most the tolerance everywhere, but in places triangles "
        "have smaller angles than min_angle: lower it, or simplify the domain's outline or the "
        "constraints there"
    )
    UNIT = "at least 98 % of the edges have a metric length from 1/sqrt(2) to sqrt(2)"
    NOT_UNIT = (
        "fewer than 98 % of the edges have a metric length from 1/sqrt(2) to sqrt(2): the metric "
        "turns or grows too fast for its own edges, or the domain is thinner than they are; scale "
        "it to shorter edges or limit its growth with gradation()"
    )

    @property
    def ok(self) -> bool:
        """Whether the tolerance is met, or the mesh is unit in its metric."""
        return self in (Status.CONVERGED, Status.UNIT)

    @property
    def usable(self) -> bool:
        """Whether the mesh is what was asked for, if only up to ``max_triangles``."""
        return self.ok or self is Status.LIMITED


@dataclass(frozen=True, eq=False)
class Boundary:
    """Boundary edges, the domain on their left.

    ``edges`` (k, 2) vertex indices, ``tags`` (k,) indices into ``names``.
    """

    edges: NDArray[np.int64]
    tags: NDArray[np.int64]
    names: tuple[str, ...]

    def edges_of(self, name: str) -> NDArray[np.int64]:
        """(j, 2) edges of one named curve."""
        return np.asarray(self.edges[self.tags == self.names.index(name)])


@dataclass(frozen=True, eq=False)
class Constraints(Boundary):
    """Edges and vertices of a mesh that stand for constraints.

    ``edges`` (k, 2) vertex indices, ``tags`` (k,) indices into ``names``: an edge is listed once
    for every name that asked for it. ``points`` (p,) are vertices that had to be, ``point_tags``
    (p,) their names.
    """

    points: NDArray[np.int64]
    point_tags: NDArray[np.int64]


def _no_constraints() -> Constraints:
    none = np.empty(0, np.int64)
    return Constraints(none.reshape(0, 2), none, (), none, none)


@dataclass(frozen=True, eq=False)
class Result:
    """A certified mesh.

    Attributes
    ----------
    points
        (n, 3) vertices x, y, z in the units of the input.
    triangles
        (m, 3) indices, counter-clockwise seen from above.
    boundary
        Tagged boundary curves.
    profile
        Every triangle's error and its bound.
    tol
        The tolerance in units of z; where the number of triangles was given or ended the run, the
        one that it reached.
    lower_bound
        N*: no interpolating mesh has fewer triangles as tol -> 0; nan where the surface is too
        rough for second derivatives to mean anything.
    efficiency
        ``lower_bound / m``.
    status
        Whether the tolerance is met, and what to do if not.
    timings
        Seconds by stage.
    metadata
        What the source knows beside its heights and a mesh should keep: of a raster ``crs``, its
        coordinate reference system as text, and ``prj``, the same as Esri writes it.
    constraints
        Edges and vertices that breaklines and points asked for, by their names.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    boundary: Boundary
    profile: Profile
    tol: float
    lower_bound: float
    status: Status
    seed: int
    input_size: str
    timings: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    constraints: Constraints = field(default_factory=_no_constraints)

    def __repr__(self) -> str:
        """One line: what was meshed, triangles, tolerance, bound and status."""
        return (
            f"Result({self.input_size}, {len(self.triangles):,} triangles, tol={self.tol:.6g}, "
            f"bound={self.profile.bound:.6g}, {self.status.name})"
        )

    @property
    def curves(self) -> Boundary:
        """The boundary and after it the constraints: all named curves, every edge in one of them.

        An edge that several ask for belongs to the first.
        """
        own, more = self.boundary, self.constraints
        edges = np.vstack([own.edges, more.edges])
        _, first = np.unique(np.sort(edges, 1), axis=0, return_index=True)
        first.sort()
        tags = np.concatenate([own.tags, more.tags + len(own.names)])
        return Boundary(edges[first], tags[first], own.names + more.names)

    @property
    def efficiency(self) -> float:
        return self.lower_bound / len(self.triangles)
