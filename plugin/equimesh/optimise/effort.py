"""How much time a mesh is worth, in lattices, rounds, visits and cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from equimesh.optimise.mesh import WIDE

__all__ = ["EFFORTS", "Effort"]

_FORESEEN = 0.985  # that well are the triangles known that a mesh will have, and N*
# What no small mesh is worth more time for: that share of N* to spare, or so many triangles for
# each of the square root of N*, of which the best meshes spend most on their border.
_SPARE, _BORDER = 0.12, 2.0
_HEATED = 20_000  # triangles; in smaller meshes dislocations are near where they cost least


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
    allow, the first numbers where lattices fit, for there is less to gain. Annealed meshes of
    ``heated`` triangles and more are heated before, and wide ones of up to ``tightened`` are
    tightened, larger lattices in a hurry. A mesh of
    ``1 + enough / sqrt(N*)`` times N* triangles gets no more of all that, nor of removal, since
    what its border costs falls like that too; of wide ones, where more can be had, the second
    number says what is enough. Without these numbers nothing is.
    """

    lattices: int = 1
    drafts: int = 1
    triangles: int = 0
    trials: int = 20
    evenings: int = 0
    rounds: int = 0
    visits: int = 120
    last_rounds: int = 0
    last_visits: int = 120
    presses: int = 0
    kept: int = 1
    cycles: int = 0
    cycled: tuple[int, int] = (0, 0)
    heated: float = math.inf
    tightened: int = 0
    enough: tuple[float, float] | None = None

    def goal(self, least: float, foreseen: float = 1.0, hurried: bool = False) -> float:
        """With how many triangles a mesh is good enough where the lower bound N* is ``least``.

        ``foreseen``: how well they are known. ``hurried``: what is enough for small meshes will
        do for a wide one.
        """
        if self.enough is None:
            return 0.0  # N* is a limit, below which small meshes may be
        border = math.sqrt(least)
        few = least + max(_SPARE * least, _BORDER * border)
        enough = self.enough[least >= WIDE and not hurried]
        return min(foreseen * (least + enough * border), few)

    def promise(self, least: float) -> float:
        """The same for triangles that are but expected."""
        return self.goal(least, _FORESEEN)


EFFORTS = {
    "fast": Effort(rounds=1),
    "balanced": Effort(
        evenings=6, last_rounds=1, presses=1, cycles=5, cycled=(4_000, 12_000),
        heated=_HEATED, tightened=150_000, enough=(4.5, 3.0),
    ),
    "best": Effort(
        lattices=200, drafts=24, triangles=60_000, trials=60, evenings=8, rounds=20, visits=300,
        last_rounds=20, last_visits=600, presses=4, kept=8, cycles=40, cycled=(300_000, 300_000),
        heated=_HEATED, tightened=300_000,
    ),
}  # fmt: skip
