"""Regions get their own numbers of vertices: what is measured, and what it is good for."""

import numpy as np
import pytest
from surfaces import FRANKE

import equimesh
from equimesh.optimise import anneal, driver, regions, tighten
from equimesh.optimise.effort import EFFORTS
from equimesh.optimise.energy import worst_errors
from equimesh.optimise.mesh import FREE, VERTICES, build, copied, restore
from equimesh.triangulation import constrained_delaunay


def grid(cells=20):
    """A square of ``cells`` by ``cells`` with errors of 0.9 everywhere."""
    t = np.linspace(0, 1, cells + 1)
    plane = np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)
    n = cells + 1
    ring = np.concatenate(
        [np.arange(n - 1), n * np.arange(1, n) - 1, n * n - 1 - np.arange(n - 1),
         n * (n - 1) - n * np.arange(n - 1)]
    )  # fmt: skip
    ring = ring[np.concatenate([[True], np.diff(ring) != 0])]
    triangles = constrained_delaunay(plane, np.stack([ring, np.roll(ring, -1)], 1))
    mesh = build(
        np.column_stack([plane, np.zeros(len(plane))]), triangles,
        np.full(len(plane), FREE, np.int8), np.zeros(len(plane), np.int64), np.zeros((1, 4)),
    )  # fmt: skip
    mesh.ee[:] = 0.9
    return mesh


def test_even_errors_are_their_own_mean():
    mesh = grid()
    around = regions.largest_around(mesh, worst_errors(mesh), 48, 4)[: int(mesh.count[VERTICES])]
    np.testing.assert_allclose(around, 0.9)


def test_one_large_error_is_seen_three_rings_away_and_no_farther():
    mesh = grid()
    at = np.argmin(np.hypot(mesh.x - 0.5, mesh.y - 0.5))
    mesh.ie[mesh.v2t[at]] = 1.05
    n = int(mesh.count[VERTICES])
    around = regions.largest_around(mesh, worst_errors(mesh), 48, 4)[:n]
    away = np.hypot(mesh.x[:n] - 0.5, mesh.y[:n] - 0.5) * 20
    assert around[at] > 0.95
    np.testing.assert_allclose(around[away > 8], 0.9)
    assert (around >= 0.9 - 1e-12).all()


def test_what_a_mesh_will_need_counts_violations_by_their_size():
    mesh = grid()
    assert regions.expected(mesh) == 800
    mesh.ie[0] = 1.01
    few = regions.expected(mesh)
    mesh.ie[0] = 1.5
    assert 800 < few < regions.expected(mesh) <= 801


def test_a_copy_brings_a_mesh_back():
    mesh = grid()
    kept = copied(mesh)
    mesh.x[:] += 1.0
    mesh.tv[3] = -1
    restore(mesh, kept)
    for part, before in zip(mesh, kept, strict=True):
        np.testing.assert_array_equal(part, before)


def test_rounds_leave_a_mesh_that_promises_fewer_triangles(monkeypatch):
    """With nothing multiplied any more, on a function that is convex here and a saddle there."""
    promises = []

    def watched(field, mesh, tol, error, queue, visits, rounds, presses, goal, report):
        driver.evaluate_all(field, mesh, tol)
        regions.press(field, mesh, tol, presses)
        promises.append(regions.expected(mesh))
        even_out(field, mesh, tol, error, queue, visits, rounds, presses, 0.0, report)
        driver.evaluate_all(field, mesh, tol)
        promises.append(regions.expected(mesh))
        assert (mesh.share == 1.0).all()

    even_out = driver.even_out
    monkeypatch.setattr(driver, "even_out", watched)
    result = equimesh.remesh(FRANKE, 5e-4, (0, 0, 1, 1))
    assert result.status.ok
    assert len(promises) == 2
    assert promises[1] < promises[0]


@pytest.mark.parametrize("tol", [5e-4, 5e-3])
def test_a_mesh_that_is_good_enough_gets_no_rounds(monkeypatch, tol):
    """Rounds end with the first mesh that promises at most the goal."""
    goals, made = [], []

    def watched(field, mesh, tol, error, queue, visits, asked, presses, goal, report):
        goals.append(goal)
        even_out(field, mesh, tol, error, queue, visits, asked, presses, 1e9, report)

    even_out = driver.even_out
    monkeypatch.setattr(driver, "even_out", watched)
    monkeypatch.setattr(regions, "exchange_all", lambda *_: made.append(1))
    result = equimesh.remesh(FRANKE, tol, (0, 0, 1, 1))
    assert result.status.ok
    assert len(goals) > 0
    assert len(made) == 0
    expected = EFFORTS["balanced"].goal(result.lower_bound)
    assert goals[0] == pytest.approx(expected, rel=0.03)


def test_what_is_good_enough_falls_to_the_lower_bound_like_the_border():
    """From a tenth or so of small meshes to a few triangles in the root of N*."""
    goal = EFFORTS["balanced"].goal
    least = np.geomspace(50, 3900, 40)
    over = np.array([goal(n) / n for n in least.tolist()])
    assert (np.diff(over) <= 1e-12).all()
    assert (over <= 1 + np.maximum(0.12, 2 / np.sqrt(least)) + 1e-12).all()
    assert goal(1e4) <= 1e4 + 4.5 * 100
    assert EFFORTS["best"].goal(1000) == 0.0


def test_what_curvature_costs_falls_with_the_root_of_the_number():
    """On Franke's function, convex here and a saddle there, as on one whose metric is flat."""
    result = equimesh.remesh(FRANKE, 1e-4, (0, 0, 1, 1))
    assert result.status.ok
    least = result.lower_bound
    assert least > 19_000
    assert len(result.triangles) <= least + 2.4 * least**0.5


def test_the_highest_powers_bring_the_largest_errors_of_a_wide_mesh_to_the_others(monkeypatch):
    """Closer than as many rounds at the lower powers do, when it is near its end."""
    spreads = []

    def watched(field, mesh, tol, rounds, enough):
        spreads.append([])
        few, more, most = rounds
        for trial_rounds in ((few + more + most, 0, 0), (few, more + most, 0), rounds):
            trial = copied(mesh)
            press(field, trial, tol, trial_rounds, enough)
            errors = worst_errors(trial)[trial.tv[:, 0] >= 0]
            spreads[-1].append(np.quantile(errors, 0.99) - np.median(errors))
        press(field, mesh, tol, rounds, enough)

    press = anneal.press
    monkeypatch.setattr(tighten, "press", watched)
    for module in (driver, tighten):  # however many triangles it promises
        monkeypatch.setattr(module, "expected", lambda mesh: np.inf)
    assert equimesh.remesh(FRANKE, 2e-4, (0, 0, 1, 1)).status.ok
    low, middle, high = np.mean(spreads[len(spreads) // 2 :], axis=0)
    assert high < 0.9 * middle < 0.8 * low
