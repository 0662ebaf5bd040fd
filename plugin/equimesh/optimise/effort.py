"""How much time a mesh is worth, in lattices, rounds, visits and cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from equimesh.optimise.mesh import WIDE

__all__ = ["AIMS", "EFFORTS", "Effort"]

AIMS = (0.93, 1.0)  # errors that cycles aim at, in units of the tolerance
_FORESEEN = 0.985  # that well are the triangles known that a mesh will have, and N*
# What no small mesh is worth more time for: that share of N* to spare, or so many triangles for
# each of the square root of N*, of which the best meshes spend most on their border.
_SPARE, _BORDER = 0.12, 2.0


@dataclass(frozen=True)
class Effort:
    """How long to look for vertices that can go.

    ``lattices``: at most so many first meshes are tried where lattices fit, ``drafts`` where they
    must be annealed, as many as ``triangles`` allow. While crystals form, an exchange may take
    ``trials`` moves of vertices to pay; in up to ``evenings`` rounds regions get their own numbers
    of vertices. Hermite's errors guide all that, with ``rounds`` of removal and at most ``visits``
    moves of vertices around every trial; ``last_rounds`` and ``last_visits`` the same for the best
    of them on the true errors, which are pressed in ``presses`` rounds. In between the ``kept``
    best drafts go through up to ``cycles`` of exchange and repair, as many as ``cycled`` triangles
    allow, the first numbers where lattices fit, for there is less to gain. In wide meshes they aim
    at errors between the two of ``aims``: above 1 where visits are few, since not all that pays
    where a whole mesh gives way does so where only a neighbourhood can. A mesh of ``1 + enough /
    sqrt(N*)`` times N* triangles gets no more of either, since what its border costs falls like
    that too; of wide ones, where more can be had, the second number says what is enough.
    """

    lattices: int
    drafts: int
    triangles: int
    trials: int
    evenings: int
    rounds: int
    visits: int
    last_rounds: int
    last_visits: int
    presses: int
    kept: int
    cycles: int
    cycled: tuple[int, int]
    enough: tuple[float, float]
    aims: tuple[float, float] = AIMS

    def goal(self, least: float) -> float:
        """With how many triangles a mesh is good enough where the lower bound N* is ``least``."""
        border = math.sqrt(least)
        few = least + max(_SPARE * least, _BORDER * border)
        enough = self.enough[least >= WIDE]
        return min(_FORESEEN * (least + enough * border), few)


_NEVER = (0.0, 0.0)  # enough
EFFORTS = {
    "fast": Effort(1, 1, 0, 30, 0, 2, 60, 0, 0, 0, 1, 0, (0, 0), _NEVER),
    "balanced": Effort(
        2, 1, 3_000, 30, 6, 0, 30, 0, 0, 1, 1, 3, (4_000, 60_000), (4.5, 3.0), (1.0, 1.08)
    ),
    "best": Effort(200, 24, 60_000, 60, 8, 20, 300, 20, 600, 4, 8, 40, (300_000, 300_000), _NEVER),
}
