"""What ``remesh`` gives back."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from equimesh.profile import Profile

__all__ = ["Boundary", "Result", "Status"]


class Status(enum.Enum):
    """How a run ended; the text tells the cause and the remedy."""

    CONVERGED = "the error is certified to be at most the tolerance everywhere"
    NOT_CONVERGED = (
        "the error exceeds the tolerance in places: the surface may have a jump or finer detail "
        "than double precision resolves there; raise the tolerance or cut the domain along the jump"
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
        The tolerance in units of z.
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

    @property
    def efficiency(self) -> float:
        return self.lower_bound / len(self.triangles)
