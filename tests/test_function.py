"""Functions as fields: the range of their heights."""

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

import equimesh
from equimesh.fields import Function

PLACE = st.floats(0.02, 0.98)
UNIT = shapely.box(0, 0, 1, 1)


@given(PLACE, PLACE)
@example(0.3711, 0.6438)
def test_a_peak_between_the_samples_is_seen(px, py):
    bump = Function(lambda x, y: np.exp(-((x - px) ** 2 + (y - py) ** 2) / 0.005))
    assert bump.span(UNIT)[1] == pytest.approx(1.0, abs=2e-3)


def test_the_range_is_that_inside_the_polygon():
    bowl = Function("(x-1/2)**2 + (y-1/2)**2")
    square = [(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)]
    low, high = bowl.span(shapely.Polygon([(0, 0), (1, 0), (1, 1), (0, 1)], [square]))
    assert low == pytest.approx(0.25**2, rel=1e-9)
    assert high == 0.5
    # A corner that no grid of the box meets.
    assert bowl.span(shapely.Polygon([(0.5, 0.5), (1, 0.501), (0.5, 0.502)]))[1] == pytest.approx(
        0.25, abs=1e-5
    )


def test_where_a_function_is_not_finite_is_told():
    with pytest.raises(equimesh.InputError, match=r"not finite at \(0, 0\)"):
        Function(lambda x, y: np.log(x + y)).span(UNIT)
