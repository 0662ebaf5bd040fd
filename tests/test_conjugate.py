"""Conjugate gradients find what a dense solver finds, in one thread and in several."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from equimesh.optimise import conjugate
from equimesh.optimise.conjugate import matrix, solve


def random_system(seed, vertices):
    """A positive definite sum of ``g g^T`` over random pairs of vertices, and its dense form."""
    rng = np.random.default_rng(seed)
    pairs = np.sort(rng.integers(0, vertices, (3 * vertices, 2)), axis=1)
    ends = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    of, dense = matrix(vertices, ends), np.zeros((2 * vertices, 2 * vertices))
    for n, (a, b) in enumerate(ends):
        g = rng.normal(size=4)
        rows = np.array([2 * a, 2 * a + 1, 2 * b, 2 * b + 1])
        block = np.outer(g, g)
        dense[np.ix_(rows, rows)] += block
        of.blocks[of.places[n, 0]] = block[:2, 2:].ravel()
        of.blocks[of.places[n, 1]] = block[2:, :2].ravel()
    for v in range(vertices):
        dense[2 * v : 2 * v + 2, 2 * v : 2 * v + 2] += 0.1 * np.eye(2)
        own = dense[2 * v : 2 * v + 2, 2 * v : 2 * v + 2]
        of.diagonal[v] = own[0, 0], own[0, 1], own[1, 1]
    return of, dense, rng.normal(size=(vertices, 2))


def solved(of, damping, downhill, left=1e-4):
    step = np.full_like(downhill, np.nan)
    solve(of, damping, downhill, step, np.full((4, *downhill.shape), np.nan), left)
    return step


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.sampled_from([0.0, 0.04, 1.0]))
@example(0, 2, 0.0)
@settings(max_examples=30, deadline=None)
def test_the_step_is_that_of_the_dense_system(seed, vertices, damping):
    of, dense, downhill = random_system(seed, vertices)
    dense += damping * np.diag(np.diag(dense))
    exact = np.linalg.solve(dense, downhill.ravel())
    found = solved(of, damping, downhill).ravel()
    # Iterations end when the residual is small, measured by the vertices' own blocks.
    error = found - exact
    assert error @ dense @ error <= 0.05 * exact @ dense @ exact


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.sampled_from([0.0, 0.04, 1.0]))
@settings(max_examples=30, deadline=None)
def test_a_rough_step_goes_downhill_as_well(seed, vertices, damping):
    of, dense, downhill = random_system(seed, vertices)
    dense += damping * np.diag(np.diag(dense))
    model = []  # what the quadratic model falls by
    for left in (1.0, 0.1, 1e-4):
        step = solved(of, damping, downhill, left).ravel()
        model.append(downhill.ravel() @ step - 0.5 * step @ dense @ step)
    assert model[0] == 0.0
    assert 0.0 < model[1] <= model[2] * (1 + 1e-12)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_find_the_same_step(monkeypatch, threads):
    of, _, downhill = random_system(1, 500)
    alone = solved(of, 0.1, downhill)
    monkeypatch.setattr(conjugate, "_MANY", 0)
    monkeypatch.setattr(conjugate, "_ROWS", 64)
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", threads)
    together = solved(of, 0.1, downhill)
    assert together == pytest.approx(alone, rel=1e-6, abs=1e-9)
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", 1)
    assert (solved(of, 0.1, downhill) == together).all()


def test_what_has_no_block_stays():
    of = matrix(3, np.array([[0, 1]]))
    of.diagonal[0] = 2.0, 0.0, 4.0
    step = solved(of, 0.0, np.array([[2.0, 2.0], [0.0, 0.0], [0.0, 0.0]]))
    assert step == pytest.approx(np.array([[1.0, 0.5], [0.0, 0.0], [0.0, 0.0]]), abs=1e-8)
