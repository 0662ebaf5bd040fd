"""Derivatives of callables by differences: closed forms, exactness, rates, and where f is asked."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from equimesh.expression import parse
from equimesh.fields.differences import stencil_derivatives
from equimesh.fields.function import Function

BOX = (0.0, 0.0, 1.0, 1.0)


def grid(box, n=13):
    """Points of the box, its corners and sides among them."""
    x, y = np.meshgrid(np.linspace(box[0], box[2], n), np.linspace(box[1], box[3], n))
    return x.ravel(), y.ravel()


@pytest.mark.parametrize(
    "text",
    ["exp(5*x)*sin(5*y)", "cos(3*x+2*y)", "log(1+x+y**2)", "exp(-4*(x-1/3)**2-3*(y-1/4)**2)"],
)
@pytest.mark.parametrize("order, accuracy", [(1, 1e-11), (2, 1e-9), (3, 2e-6)])
def test_smooth_functions_have_their_symbolic_derivatives(text, order, accuracy):
    expression = parse(text)
    x, y = grid(BOX)
    ours = stencil_derivatives(expression.value, x, y, BOX, order)
    if order == 2:
        h = expression.hessian(x, y)
        exact = np.stack([h[:, 0, 0], h[:, 0, 1], h[:, 1, 1]], 1)
    else:
        exact = expression.gradient(x, y) if order == 1 else expression.third(x, y)
    assert np.abs(ours - exact).max() <= accuracy * np.abs(exact).max()


@given(st.integers(0, 2**32 - 1))
def test_polynomials_of_degree_ten_are_differentiated_exactly(seed):

    rng = np.random.default_rng(seed)
    c = rng.normal(size=(11, 11))
    box = (-30.0, -30.0, 30.0, 30.0)  # stencils as wide as 1.2 about the points
    x, y = rng.uniform(-0.5, 0.5, (2, 20))
    ours = stencil_derivatives(
        lambda u, v: np.polynomial.polynomial.polyval2d(u, v, c), x, y, box, 3
    )
    for k in range(4):
        d = np.polynomial.polynomial.polyder(c, 3 - k, axis=0)
        d = np.polynomial.polynomial.polyder(d, k, axis=1)
        exact = np.polynomial.polynomial.polyval2d(x, y, d)
        assert np.abs(ours[:, k] - exact).max() <= 1e-8 * np.abs(c).max()


def test_each_axis_has_a_width_of_its_own():
    box = (0.0, 0.0, 1.0, 50.0)
    x, y = grid(box, 7)
    first = stencil_derivatives(lambda u, v: np.sin(u) * np.cos(v / 50), x, y, box, 1)
    mixed = stencil_derivatives(lambda u, v: np.sin(u) * np.cos(v / 50), x, y, box, 2)
    assert first[:, 1] == pytest.approx(-np.sin(x) * np.sin(y / 50) / 50, abs=1e-11)
    assert mixed[:, 1] == pytest.approx(-np.cos(x) * np.sin(y / 50) / 50, abs=1e-9)
    assert mixed[:, 2] == pytest.approx(-np.sin(x) * np.cos(y / 50) / 2500, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_truncation_falls_with_the_power_of_the_width(order):
    # Degree 10 in x: a derivative of that order loses as many powers of the width.
    x, y = np.linspace(0.4, 0.6, 101), np.full(101, 0.5)
    widths = np.array([1.0, 0.7, 0.5])
    errors = []
    for width in widths:
        box = (0.5 - width, 0.0, 0.5 + width, 1.0)
        ours = stencil_derivatives(lambda u, v: np.sin(90 * u) + 0 * v, x, y, box, order)[:, 0]
        exact = 90.0**order * np.sin(90 * x + order * math.pi / 2)
        errors.append(np.abs(ours - exact).max())
    slope = np.polyfit(np.log(widths), np.log(errors), 1)[0]
    assert slope == pytest.approx(11 - order + order % 2, abs=1.3)


@given(st.integers(0, 2**32 - 1))
def test_f_is_never_asked_outside_the_box(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-5, 5, 2)
    box = (*low, *(low + rng.uniform(0.01, 10, 2)))
    asked = []

    def f(x, y):
        asked.append((x.min(), y.min(), x.max(), y.max()))
        return x * y

    x, y = grid(box, 5)
    stencil_derivatives(f, x, y, box, 2)
    lowest, highest = np.min(asked, axis=0)[:2], np.max(asked, axis=0)[2:]
    slack = 1e-14 * np.abs(box).max()
    assert (lowest >= np.array(box[:2]) - slack).all()
    assert (highest <= np.array(box[2:]) + slack).all()


def test_more_points_than_one_block_keep_their_order():
    x = np.linspace(0, 1, 9001)
    d = stencil_derivatives(lambda u, v: np.exp(u) + v, x, 0 * x + 0.5, BOX, 1)
    assert d[:, 0] == pytest.approx(np.exp(x), abs=1e-11)
    assert d[:, 1] == pytest.approx(1.0, abs=1e-11)


@given(st.floats(1e-3, 1e3), st.floats(-10, 10))
@example(1.0, 8.0)
def test_units_and_origin_of_the_box_do_not_matter(size, boxes):
    shift = boxes * size
    box = (shift, shift, shift + size, shift + size)
    u, v = grid(BOX, 5)
    x, y = shift + size * u, shift + size * v

    def f(px, py):
        return np.exp((px - shift) / size) * np.cos((py - shift) / size)

    ours = stencil_derivatives(f, x, y, box, 2) * size**2
    e, s = (x - shift) / size, (y - shift) / size
    exact = np.stack([np.exp(e) * np.cos(s), -np.exp(e) * np.sin(s), -np.exp(e) * np.cos(s)], 1)
    # Coordinates are rounded in proportion to their distance from zero.
    assert np.abs(ours - exact).max() <= 1e-8 * (1 + abs(boxes))


def test_a_callable_and_its_text_have_the_same_hessians():
    text = Function("sin(4*x)*exp(y)+x*y**3")
    call = Function(lambda x, y: np.sin(4 * x) * np.exp(y) + x * y**3, box=BOX)
    x, y = grid(BOX)
    assert call.gradient(x, y) == pytest.approx(text.gradient(x, y), abs=1e-10)
    assert call.hessian(x, y) == pytest.approx(text.hessian(x, y), abs=1e-8)
    assert call.third(x, y) == pytest.approx(text.third(x, y), abs=1e-5)
