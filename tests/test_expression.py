"""Arithmetic from text: right values, exact derivatives, nothing else let in."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from equimesh.errors import InputError
from equimesh.expression import parse

POINTS = np.random.default_rng(7).uniform(0.15, 0.85, (40, 2)).T

# Every allowed function, with the same thing said in NumPy.
SMOOTH = {
    "exp(5*x)*sin(5*y)": lambda x, y: np.exp(5 * x) * np.sin(5 * y),
    "x^2*y - y**3/3 + 0.1": lambda x, y: x**2 * y - y**3 / 3 + 0.1,
    "-x^2 + +y": lambda x, y: -(x**2) + y,
    "2^-x + x^y": lambda x, y: 2**-x + x**y,
    "tan(x*y) + cos(pi*x)": lambda x, y: np.tan(x * y) + np.cos(np.pi * x),
    "asin(x) + acos(y) + atan(x + y)": lambda x, y: np.arcsin(x) + np.arccos(y) + np.arctan(x + y),
    "atan2(y, x)": lambda x, y: np.arctan2(y, x),
    "sinh(x) * cosh(y)": lambda x, y: np.sinh(x) * np.cosh(y),
    "tanh(9*(y - x)) + e^x": lambda x, y: np.tanh(9 * (y - x)) + np.exp(x),
    "log(x) + log10(1 + y) / 3": lambda x, y: np.log(x) + np.log10(1 + y) / 3,
    "sqrt(x*y) + hypot(x, y)": lambda x, y: np.sqrt(x * y) + np.hypot(x, y),
    "erf(3*x*y)": lambda x, y: np.vectorize(math.erf)(3 * x * y),
    "abs(x - y)*x + sign(y - x)*y": lambda x, y: np.abs(x - y) * x + np.sign(y - x) * y,
    "max(x, y, 0.3)*x - min(x, y)*y": lambda x, y: (
        np.maximum(np.maximum(x, y), 0.3) * x - np.minimum(x, y) * y
    ),
}  # fmt: skip


def taylor_residual(text, step):
    """Largest error of the cubic Taylor polynomial at distance ``step``, over points."""
    f = parse(text)
    x, y = POINTS
    direction = np.array([0.6, -0.8])
    d1 = f.gradient(x, y) @ direction
    d2 = np.einsum("nij,i,j->n", f.hessian(x, y), direction, direction)
    binomial = np.array([1, 3, 3, 1])
    powers = direction[0] ** np.array([3, 2, 1, 0]) * direction[1] ** np.array([0, 1, 2, 3])
    d3 = f.third(x, y) @ (binomial * powers)
    cubic = f.value(x, y) + step * d1 + step**2 / 2 * d2 + step**3 / 6 * d3
    return np.abs(f.value(x + step * direction[0], y + step * direction[1]) - cubic)


@pytest.mark.parametrize("text", SMOOTH)
def test_values_are_those_of_numpy(text):
    np.testing.assert_allclose(parse(text).value(*POINTS), SMOOTH[text](*POINTS), rtol=1e-13)


@pytest.mark.parametrize("text", SMOOTH)
def test_the_cubic_taylor_polynomial_errs_by_the_fourth_power_of_the_step(text):
    # All ten derivatives at once: one wrong entry would leave a lower power. Points whose segment
    # crosses a kink have no Taylor polynomial; the median does not see those few.
    coarse, fine = (np.median(taylor_residual(text, step)) for step in (1e-2, 5e-3))
    assert fine < max(coarse / 15, 1e-14)


def test_mixed_derivatives_are_in_their_places():
    f = parse("x^3*y^2")
    x, y = 2.0, 3.0
    assert f.gradient(x, y).tolist() == [3 * x**2 * y**2, 2 * x**3 * y]
    assert f.hessian(x, y).tolist() == [[6 * x * y**2, 6 * x**2 * y], [6 * x**2 * y, 2 * x**3]]
    assert f.third(x, y).tolist() == [6 * y**2, 12 * x * y, 6 * x**2, 0.0]


@pytest.mark.parametrize("text", ["3", "0*x", "x", "x*y", "2*x + 3"])
def test_constants_broadcast_to_the_shape_of_the_points(text):
    f, x, y = parse(text), np.zeros((4, 1)), np.zeros(3)
    assert f.value(x, y).shape == (4, 3)
    assert f.gradient(x, y).shape == (4, 3, 2)
    assert f.hessian(x, y).shape == (4, 3, 2, 2)
    assert f.third(x, y).shape == (4, 3, 4)
    assert f.value(0.0, 0.0).shape == ()
    assert f.value(np.empty(0), np.empty(0)).shape == (0,)


def test_integers_are_taken_as_numbers():
    assert parse("x/2").value([1, 2], [0, 0]).tolist() == [0.5, 1.0]
    assert parse("x**-1").value(4, 0) == 0.25


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=0))
def test_every_literal_keeps_its_last_bit(number):
    assert parse(repr(number)).value(0.0, 0.0) == number
    assert parse(f"{number!r}*x").value(1.0, 0.0) == number


@given(st.integers(min_value=0, max_value=10**40))
def test_long_integers_become_the_nearest_double(number):
    assert parse(f"x*{number}").value(1.0, 0.0) == float(number)


def test_outside_its_real_domain_a_formula_is_nan_without_a_warning(recwarn):
    assert np.isnan(parse("log(x) + sqrt(y)").value([-1.0, 1.0], [1.0, -1.0])).all()
    assert not recwarn.list


def test_a_long_polynomial_is_no_deep_nesting():
    text = " + ".join(f"{k}.25*x**{k % 7}*y**{k % 5}" for k in range(180))
    x, y = POINTS
    expected = sum((k + 0.25) * x ** (k % 7) * y ** (k % 5) for k in range(180))
    np.testing.assert_allclose(parse(text).value(x, y), expected, rtol=1e-12)


REFUSED = [
    "", "   ", "#", "2x", "sin(x", "x y", "x;y", "x\ny", "x\0",
    "__import__('os')", "open('/etc/passwd')", "exec('1')", "eval('x')", "print(x)",
    "x.real", "x.__class__", "().__class__", "(x).__class__.__mro__", "[x]", "(x, y)", "{x}",
    "{x: y}",
    "lambda: x", "x if y else 1", "x := 3", "(x := 3)", "x[0]", "x < y", "x and y", "not x",
    "x // 2", "x % 2", "x @ y", "x | y", "x << 2", "~x", "True", "None", "...", "'x'", "b'x'",
    "f'{x}'",
    "1j", "z", "sin", "pi(x)", "sin()", "sin(x, y)", "sin(x, y=2)", "sin(*x)", "atan2(x)", "max(x)",
    "[x for x in y]", "await x", "yield x", "import os", "x = 3",
    "1/0", "x/0", "x/(x - x)", "0**-1", "sqrt(-1)", "log(0)", "log(-2)", "asin(2)", "(-8)**0.5",
    "1e400", "9" * 3000, "10**400", "exp(1000)", "9**9**9**9", "x**9**9**9", "x**1001",
    "x**(2*3000)",
    "((2*x)**1000)**1000", "((x + x)**1000/x**1000)**1000", "((((x**99)**99)**99)**99)**99",
    "exp(exp(exp(exp(10))))", "(((((9**99)**99)**99)**99)**99)", "x**-99999999999999999999",
    "(" * 3000 + "x", "(" * 300 + "x" + ")" * 300, "-" * 3000 + "x", "sin(" * 60 + "x" + ")" * 60,
    "x**" * 1000 + "x", "x" * 5000, "x+" * 5_000_000 + "x", "sqrt(-x**2)*0 + sqrt(-4)",
]  # fmt: skip


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:25])
def test_whatever_is_not_short_arithmetic_is_refused_at_once_in_one_sentence(text):
    started = time.perf_counter()
    with pytest.raises(InputError) as refusal:
        parse(text)
    assert time.perf_counter() - started < 1.0
    sentence = str(refusal.value)
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert len(sentence) < 250


def test_the_refusal_names_the_part_and_what_is_allowed():
    with pytest.raises(InputError, match=r"'__import__'.*allowed are numbers, x, y, pi.*erf"):
        parse("x + __import__('os')")


def test_nothing_is_executed(tmp_path):
    trap = tmp_path / "trap"
    for text in (f"open({str(trap)!r}, 'w')", f"__import__('pathlib').Path({str(trap)!r}).touch()"):
        with pytest.raises(InputError):
            parse(text)
    assert not trap.exists()


def test_endless_derivatives_are_refused_rather_than_compiled():
    f = parse("sin(" * 35 + "x*y" + ")" * 35)
    assert np.isfinite(f.value(*POINTS)).all()
    with pytest.raises(InputError, match="too long derivatives"):
        f.third(*POINTS)


@given(st.text(max_size=60))
def test_any_text_is_either_read_or_refused(text):
    try:
        f = parse(text)
    except InputError:
        return
    assert f.value(0.5, 0.5).shape == ()


@given(st.text(alphabet="xy0123456789.+-*/^()e, sincotaexplgqrhbmd", max_size=40))
def test_any_near_arithmetic_is_either_read_or_refused(text):
    try:
        f = parse(text)
    except InputError:
        return
    assert f.value(0.5, 0.5).shape == ()
