"""Vertices from where they are too many to where they are too few, region by region.

A crystal without defects could be laid almost at the tolerance; where dislocations are dense the
largest errors are well above the mean. One error to anneal for serves neither. Here each region has
its own: as if by a multiplier of Lagrange, errors count for less where even the largest stay low,
and for more where they do not, until the largest are alike everywhere. Vertices come and go at the
lowest power, which climbs over what stands between, and the highest tells where they lack.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.kernel import KernelField
from equimesh.optimise.anneal import bowls, exchange_all, press, shares
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.mesh import SOFT, Mesh, copied, is_wide, restore
from equimesh.optimise.relax import Queue
from equimesh.stages import Report

__all__ = ["even_out", "expected", "largest_around", "regional_shares"]

# The largest errors to be, in units of the tolerance: the second in a wide mesh, which is pressed
# harder,
_GOAL, _GOAL_WIDE = 0.985, 1.0
_POWER = 48  # by a mean of this power
_STARS = 4  # over so many stars, one in another
# The power by which shares change: the errors of a saddle follow at once only in part. (By this one
# two rounds do for four.) Those of wide crystals follow at once.
_EAGER = 1.7
_LEAST, _MOST = 0.88, 1.08  # shares: some errors do not give way to any number of vertices
_CEILING = 1.3  # larger errors are no question of density
# Triangles that it takes to mend one whose error is so much above 1, and less for less: a fit to
# what 45 meshes took.
_MENDING, _MUCH = 0.25, 0.02
_GAIN = 5e-4  # of the triangles: after a round that saves less there is no more


def even_out(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    error: float,
    queue: Queue,
    visits: int,
    rounds: int,
    presses: tuple[int, int, int],
    goal: float,
    report: Report,
) -> None:
    """Up to so many ``rounds`` of exchanges of an annealed mesh, each followed by a press; leaves
    the best of the meshes in between.

    They end with a mesh that promises at most ``goal`` triangles. ``error``: what it was annealed
    for at first. ``visits``: how many moves of vertices around an exchange may make it pay.
    ``presses``: rounds of pressing before errors are looked at.
    """
    if rounds == 0:
        return
    share, best, least = shares(mesh, error), copied(mesh), math.inf
    for number in range(rounds + 1):
        evaluate_all(field, mesh, tol)
        press(field, mesh, tol, presses)
        now = expected(mesh)
        idle = not now < (1.0 - _GAIN) * least
        if now < least:
            restore(best, mesh)
            least = now
        if number == rounds or idle or least <= goal:
            break
        crystals = bowls(mesh) & is_wide(mesh)
        mesh.share[:] = regional_shares(mesh, share, np.where(crystals, 1.0, _EAGER))
        exchange_all(field, mesh, error * tol, queue, visits, SOFT)
        share = mesh.share.copy()
        mesh.share[:] = 1.0
        report((number + 1) / rounds)
    restore(mesh, best)


def regional_shares(
    mesh: Mesh, share: NDArray[np.float64], power: NDArray[np.float64] | float = 1.0
) -> NDArray[np.float64]:
    """(v,) the next shares: larger where the largest errors around a vertex are, for the last.

    ``power`` of what these errors are off by: shares change by so much.
    """
    goal = _GOAL_WIDE if is_wide(mesh) else _GOAL
    errors = np.minimum(worst_errors(mesh), _CEILING)
    largest = largest_around(mesh, errors, _POWER, _STARS)
    return np.clip(share * (largest / goal) ** power, _LEAST, _MOST)


def expected(mesh: Mesh) -> float:
    """About how many triangles the mesh will have when all keep the tolerance."""
    worst = worst_errors(mesh)[mesh.tv[:, 0] >= 0]
    return float(len(worst) + _MENDING * np.clip((worst - 1.0) / _MUCH, 0.0, 1.0).sum())


def largest_around(
    mesh: Mesh, errors: NDArray[np.float64], power: float, stars: int
) -> NDArray[np.float64]:
    """(v,) mean of this power of the ``errors`` (t,) in the stars around each vertex, one in
    another, so many of them; 0 where there is no vertex."""
    live = np.flatnonzero(mesh.tv[:, 0] >= 0)
    corners = mesh.tv[live]
    mean = errors[live] ** power
    number = np.maximum(np.bincount(corners.ravel(), minlength=len(mesh.x)), 1)
    around = np.zeros(len(mesh.x))
    for _ in range(stars):
        around = np.bincount(corners.ravel(), np.repeat(mean, 3), len(mesh.x)) / number
        mean = around[corners].mean(1)
    return np.asarray(around ** (1.0 / power))
