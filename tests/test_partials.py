"""Polynomials in vectors of numbers are what the same polynomials are one by one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyder, polyval2d

from equimesh.fields.compiled import compiled
from equimesh.fields.partials import partials0, partials1, partials2, partials3, values8

UNIT = st.floats(-1, 1)


@compiled
def to_order0(coef, leaf, s, t):
    return partials0(coef, leaf, s, t)


@compiled
def to_order1(coef, leaf, s, t):
    return partials1(coef, leaf, s, t)


@compiled
def to_order2(coef, leaf, s, t):
    return partials2(coef, leaf, s, t)


@compiled
def to_order3(coef, leaf, s, t):
    return partials3(coef, leaf, s, t)


@compiled
def at_eight(coef, leaf, s, t):
    return values8(coef, leaf, s, t)


COEF = np.random.default_rng(0).normal(size=(3, 8, 8))


@given(st.integers(0, 2), UNIT, UNIT)
@pytest.mark.parametrize("order", range(4))
def test_derivatives_are_those_of_the_polynomial(order, leaf, s, t):
    found = (to_order0, to_order1, to_order2, to_order3)[order](COEF, leaf, s, t)
    orders = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
    assert len(found) == len(orders)
    for ours, (i, j) in zip(found, orders, strict=True):
        exact = polyval2d(s, t, polyder(polyder(COEF[leaf], i, axis=0), j, axis=1))
        size = np.abs(polyder(polyder(COEF[leaf], i, axis=0), j, axis=1)).sum()
        assert math.isclose(ours, exact, rel_tol=0.0, abs_tol=1e-14 * size)


@given(st.integers(0, 2), st.tuples(*[UNIT] * 8), st.tuples(*[UNIT] * 8))
def test_eight_values_are_those_of_one_place_each(leaf, s, t):
    one_by_one = [to_order0(COEF, leaf, *place)[0] for place in zip(s, t, strict=True)]
    assert list(at_eight(COEF, leaf, s, t)) == one_by_one
