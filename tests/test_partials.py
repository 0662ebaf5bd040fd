"""Polynomials in vectors of numbers are what the same polynomials are one by one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from numpy.polynomial.polynomial import polyder, polyval2d

from equimesh.fields.partials import partials0, partials1, partials2, partials3, values8

UNIT = st.floats(-1, 1)


def kernel(intrinsic):
    return njit(lambda coef, leaf, s, t: intrinsic(coef, leaf, s, t))


TO_ORDER = [kernel(partials) for partials in (partials0, partials1, partials2, partials3)]
AT_EIGHT = kernel(values8)
COEF = np.random.default_rng(0).normal(size=(3, 8, 8))


@given(st.integers(0, 2), UNIT, UNIT)
@pytest.mark.parametrize("order", range(4))
def test_derivatives_are_those_of_the_polynomial(order, leaf, s, t):
    found = TO_ORDER[order](COEF, leaf, s, t)
    orders = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
    assert len(found) == len(orders)
    for ours, (i, j) in zip(found, orders, strict=True):
        exact = polyval2d(s, t, polyder(polyder(COEF[leaf], i, axis=0), j, axis=1))
        size = np.abs(polyder(polyder(COEF[leaf], i, axis=0), j, axis=1)).sum()
        assert math.isclose(ours, exact, rel_tol=0.0, abs_tol=1e-14 * size)


@given(st.integers(0, 2), st.tuples(*[UNIT] * 8), st.tuples(*[UNIT] * 8))
def test_eight_values_are_those_of_one_place_each(leaf, s, t):
    one_by_one = [TO_ORDER[0](COEF, leaf, *place)[0] for place in zip(s, t, strict=True)]
    assert list(AT_EIGHT(COEF, leaf, s, t)) == one_by_one
