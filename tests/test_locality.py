"""The Z-curve: every point once, and the next one near."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from equimesh.locality import curve_order


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.floats(1e-9, 1e9))
def test_every_point_comes_once_whatever_the_units(seed, count, size):
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 2))
    order = curve_order(size * points)
    assert sorted(order) == list(range(count))


def test_points_in_one_place_keep_their_order():
    assert list(curve_order(np.ones((5, 2)))) == [0, 1, 2, 3, 4]


def test_four_quarters_follow_each_other():
    corners = np.array([[0.9, 0.9], [0.1, 0.9], [0.9, 0.1], [0.1, 0.1]])
    assert list(curve_order(corners)) == [3, 2, 1, 0]


def test_the_next_point_is_near():
    """Of n random points in a square the next is about n^-1/2 away, not about 1/2."""
    points = np.random.default_rng(1).uniform(size=(10_000, 2))
    ordered = points[curve_order(points)]
    steps = np.hypot(*np.diff(ordered, axis=0).T)
    assert steps.mean() < 2.5 / np.sqrt(len(points))
