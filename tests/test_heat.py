"""Exchanges at a temperature: chances look random, and what was heated has less energy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from surfaces import FRANKE

import equimesh
from equimesh.optimise import anneal, driver, exchange
from equimesh.optimise.mesh import MANNER, MODEL, SOFT, copied, triangles_in
from equimesh.optimise.relax import make_queue

AIM = 0.95


class Annealed(Exception):
    """Carries what a wide mesh is when it was annealed and evened out."""


@pytest.fixture(scope="module")
def start():
    """Field, mesh of some 5,000 triangles over Franke's function, and tolerance."""

    def stop(field, mesh, tol, *_args, **_options):
        raise Annealed(field, copied(mesh), tol)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driver, "tighten", stop)
        patch.setattr(driver, "expected", lambda _: np.inf)  # however many triangles it promises
        with pytest.raises(Annealed) as caught:
            equimesh.remesh(FRANKE, 4e-4, (0, 0, 1, 1))
    return caught.value.args


def energy(field, mesh, tol):
    """In triangles: what ``sum e^6`` costs at their price, and they themselves."""
    driver.evaluate_all(field, mesh, AIM * tol)
    live = mesh.tv[:, 0] >= 0
    powers = 0.5 * (mesh.ee[live] ** 6).sum() + (mesh.ie[live] ** 6).sum()
    return powers / 7.0 + triangles_in(mesh)


def heated(start, patch, hottest):
    field, mesh, tol = start
    mesh = copied(mesh)
    mesh.count[MODEL] = 1
    patch.setattr(anneal, "_HOTTEST", hottest)
    patch.setattr(anneal, "shares", lambda mesh, _error: np.ones(len(mesh.x)))
    anneal.heat(field, mesh, tol, AIM, make_queue(len(mesh.x)), lambda _: None)
    return mesh, energy(field, mesh, tol)


def test_what_is_heated_and_cooled_has_less_energy_than_what_was_cold_all_the_time(
    start, monkeypatch
):
    _, cold = heated(start, monkeypatch, 0.0)
    _, warm = heated(start, monkeypatch, 0.3)
    assert cold < energy(*start)
    assert warm < cold - 5.0


@pytest.mark.parametrize("hot", [0.3, 1.0])
def test_in_the_heat_exchanges_that_cost_energy_are_kept_as_well(start, hot):
    field, mesh, tol = start
    kept, after = [], []
    for heat in (0.0, hot):
        trial = copied(mesh)
        trial.count[MODEL], trial.count[MANNER] = 1, SOFT
        driver.evaluate_all(field, trial, AIM * tol)
        stamp, queue = np.zeros(len(trial.x), np.int64), make_queue(len(trial.x))
        kept.append(exchange.exchange_once(field, trial, AIM * tol, queue, 60, stamp, 1, 0.5, heat))
        after.append(energy(field, trial, tol))
    assert kept[1] > 1.5 * kept[0]
    assert after[1] > after[0]


def test_heat_is_the_same_each_time(start, monkeypatch):
    one, other = (heated(start, monkeypatch, 0.3)[0] for _ in range(2))
    np.testing.assert_array_equal(one.tv, other.tv)
    np.testing.assert_array_equal(one.x, other.x)


def test_chances_are_even_and_do_not_follow_each_other():
    draws = itertools.product(range(500), range(1, 21), (0, 1))
    chances = np.array([exchange._chance(*draw) for draw in draws])
    assert ((chances > 0.0) & (chances < 1.0)).all()
    counts = np.histogram(chances, 20, (0.0, 1.0))[0]
    expected = len(chances) / 20
    off = ((counts - expected) ** 2 / expected).sum()
    assert off < 43.8  # chi^2 of 19 degrees: one in a thousand
    for lag in (1, 2, 40):
        assert abs(np.corrcoef(chances[:-lag], chances[lag:])[0, 1]) < 0.03
