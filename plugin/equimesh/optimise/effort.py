"""How much time a mesh is worth, in lattices, rounds, visits and cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["AIMS", "EFFORTS", "Effort"]

AIMS = (0.93, 1.0)  # errors that cycles aim at, in units of the tolerance
_FORESEEN = 0.985  # that well are the triangles known that a mesh will have, and N*


@dataclass(frozen=True)
class Effort:
    """How long to look for vertices that can go.

    ``lattices``: at most so many first meshes are tried where lattices fit, ``drafts`` where they
    must be annealed (the second number where there are so few triangles that one draft may be far
    from the next), as many as ``triangles`` allow. While crystals form, an exchange may take
    ``trials`` moves of vertices to pay; in up to ``evenings`` rounds regions get their own numbers
    of vertices. Hermite's errors guide all that, with ``rounds`` of removal and at most ``visits``
    moves of vertices around every trial; ``last_rounds`` and ``last_visits`` the same for the best
    of them on the true errors, which are pressed in ``presses`` rounds. In between the ``kept``
    best drafts go through up to ``cycles`` of exchange and repair, as many as ``cycled`` triangles
    allow, the first numbers where lattices fit, for there is less to gain. In wide meshes they aim
    at errors between the two of ``aims``: above 1 where visits are few, since not all that pays
    where a whole mesh gives way does so where only a neighbourhood can. A mesh of ``1 + enough /
    sqrt(N*)`` times N* triangles gets no more of either, or one if it is very small: what its
    border costs falls like that too.
    """

    lattices: int
    drafts: tuple[int, int]
    triangles: int
    trials: int
    evenings: int
    rounds: int
    visits: int
    last_rounds: int
    last_visits: int
    presses: int
    kept: tuple[int, int]
    cycles: int
    cycled: tuple[int, int]
    enough: float
    aims: tuple[float, float] = AIMS

    def goal(self, least: float) -> float:
        """With how many triangles a mesh is good enough where the lower bound N* is ``least``."""
        return _FORESEEN * (least + self.enough * math.sqrt(least))


EFFORTS = {
    "fast": Effort(1, (1, 1), 0, 30, 0, 2, 60, 0, 0, 0, (1, 1), 0, (0, 0), 0.0),
    "balanced": Effort(
        2, (2, 4), 3_000, 30, 6, 0, 30, 0, 0, 1, (1, 2), 3, (4_000, 60_000), 4.5, (1.0, 1.08)
    ),
    "best": Effort(
        200, (24, 24), 60_000, 60, 8, 20, 300, 20, 600, 4, (8, 8), 40, (300_000, 300_000), 0.0
    ),
}
