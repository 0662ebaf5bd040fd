"""The longest part of ``best`` on data: focused search over the whole mesh, round after round."""

from __future__ import annotations

import numpy as np

from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.focus import exchange_round, make_search
from equimesh.optimise.mesh import Mesh, movable
from equimesh.stages import Report

__all__ = ["search_all"]

# Removals tried: in all, and rounds at least and at most.
_TRIALS, _FEWEST_ROUNDS, _MOST_ROUNDS = 1_600_000, 8, 1000
# The search ends where so many in a row, at least so many rounds, have taken out none.
_IDLE_TRIALS, _IDLE_ROUNDS = 10_000, 40
_PART = 500  # removals between two reports


def search_all(field: KernelField, mesh: Mesh, tol: float, report: Report) -> None:
    """Remove or exchange vertices of a mesh that keeps ``tol``, in random order, again and again.

    Errors of data are exact: unlike what comes before, the search needs no margin below ``tol``.
    """
    evaluate_all(field, mesh, tol)
    search, order = make_search(mesh), np.random.default_rng(0)
    first = max(len(movable(mesh)), 1)
    rounds = int(np.clip(_TRIALS // first, _FEWEST_ROUNDS, _MOST_ROUNDS))
    idle = tried = 0  # rounds and trials since the last removal
    for number in range(rounds):
        candidates = movable(mesh)
        if len(candidates) == 0:
            break
        order.shuffle(candidates)
        gone = 0
        for start in range(0, len(candidates), _PART):
            part = candidates[start : start + _PART]
            gone += exchange_round(field, mesh, tol, search, part)[0]
            report((number + (start + len(part)) / len(candidates)) / rounds)
        idle, tried = (0, 0) if gone else (idle + 1, tried + len(candidates))
        if idle >= _IDLE_ROUNDS and tried >= _IDLE_TRIALS:
            break
