"""The verdict on a metric: curvature, zeros of det H, and loops that (12) does not close."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
import sympy
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from surfaces import FRANKE

from equimesh.errors import InputError
from equimesh.flatness import flatness
from equimesh.transform import FlatMap

SQUARE = (0.0, 0.0, 1.0, 1.0)
AROUND = (-1.0, -1.0, 1.0, 1.0)
QUARTIC = "x**4+y**4+x**2*y**2"


class Cone:
    """``f = |p|^k (1 + a cos(n t))`` of p = (x, y) - apex: homogeneous of degree k about its
    apex."""

    def __init__(self, k, a, n, apex=(0.0, 0.0)):
        self.k, self.a, self.n, self.apex = k, a, n, apex
        x, y = sympy.symbols("x y", real=True)
        wave = sympy.re(sympy.expand((x + sympy.I * y) ** n))
        f = (x**2 + y**2) ** (sympy.Rational(str(k)) / 2) * (
            1 + sympy.Rational(str(a)) * wave / (x**2 + y**2) ** (sympy.Rational(n) / 2)
        )
        entries = [f.diff(*((x,) * i), *((y,) * j)) for i, j in ((2, 0), (1, 1), (0, 2))]
        thirds = [f.diff(*((x,) * i), *((y,) * (3 - i))) for i in (3, 2, 1, 0)]
        self._second = sympy.lambdify((x, y), entries, cse=True)
        self._third = sympy.lambdify((x, y), thirds, cse=True)

    def _at(self, function, x, y):
        with np.errstate(all="ignore"):
            return [
                np.broadcast_to(v, np.shape(x)) + 0.0
                for v in function(x - self.apex[0], y - self.apex[1])
            ]

    def hessian(self, x, y):
        xx, xy, yy = self._at(self._second, x, y)
        h = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
        # At the apex itself all second derivatives of a degree above 2 are zero.
        h[(x == self.apex[0]) & (y == self.apex[1])] = 0.0
        return h

    def third(self, x, y):
        out = np.stack(self._at(self._third, x, y), axis=-1)
        out[(x == self.apex[0]) & (y == self.apex[1])] = 0.0
        return out

    @property
    def angle(self):
        """Total angle around the apex, in polar coordinates of the metric.

        ``ds^2 = k (k - 1) g (dr / r)^2 + 2 (k - 1) g' dt (dr / r) + (k g + g'') dt^2``, times r^k.
        Straight lines of the unrolled cone leave its apex as rays t = const, whose length from the
        apex is ``s = 2 sqrt((1 - 1/k) g) r^(k/2)``; ``ds^2 = d(s)^2 + s^2 d(angle)^2``.
        """

        def rate(t):
            g = 1 + self.a * math.cos(self.n * t)
            first = -self.a * self.n * math.sin(self.n * t)
            second = -self.a * self.n**2 * math.cos(self.n * t)
            across = self.k * g + second - (1 - 1 / self.k) * first**2 / g
            return math.sqrt(across / (4 * (1 - 1 / self.k) * g))

        return quad(rate, 0.0, 2 * math.pi, epsabs=1e-11, epsrel=1e-11, limit=200)[0]


def covers(domain, where):
    return shapely.box(*domain).buffer(1e-9).covers(shapely.Point(where))


def test_frankes_function_is_not_flat_by_its_curvature():
    result = flatness(FRANKE, SQUARE)
    assert (result.verdict, result.cause) == ("not flat", "curvature")
    assert result.amount == result.gamma > 1.0
    assert result.share > 0.5
    assert covers(SQUARE, result.where)
    assert str(result).startswith("not flat: |Gamma| = ")


@pytest.mark.parametrize("domain", [AROUND, SQUARE, (-0.3, -0.7, 1.1, 0.9), (-1.0, 0.0, 1.0, 0.5)])
@pytest.mark.parametrize("given_as", ["text", "callable"])
def test_the_quartic_is_not_flat_wherever_the_closed_domain_holds_its_apex(domain, given_as):
    source = QUARTIC if given_as == "text" else lambda x, y: x**4 + y**4 + (x * y) ** 2
    result = flatness(source, domain)
    assert (result.verdict, result.cause) == ("not flat", "apex")
    assert result.gamma < 1e-10
    assert np.abs(result.where).max() < 1e-6
    # x^4 + y^4 + x^2 y^2 = r^4 (7 + cos 4 t) / 8.
    angle = Cone(4, 1 / 7, 4).angle
    assert angle == pytest.approx(math.radians(409.0042), rel=1e-6)
    assert result.apexes[0].angle == pytest.approx(angle, rel=1e-7)
    # Turned by that angle, a vector comes back changed by the entries of R - 1.
    assert result.amount == pytest.approx(abs(math.sin(angle)), rel=1e-6)
    assert "409 degrees" in str(result)


@pytest.mark.parametrize("domain", [(0.1, 0.1, 1, 1), (1e-3, 0, 1, 1), (-2, 0.01, 2, 1)])
def test_the_quartic_is_flat_on_domains_without_its_apex(domain):
    assert flatness(QUARTIC, domain).flat
    flat_map = FlatMap(QUARTIC, domain)
    assert flat_map.flatness.flat
    assert flat_map.residual < 1e-9


def test_a_flat_map_of_a_domain_with_an_apex_is_refused():
    for domain in (AROUND, SQUARE):
        with pytest.raises(InputError, match=r"vanishes or is not finite near \(0, 0\)"):
            FlatMap(QUARTIC, domain)


@settings(max_examples=20, deadline=None)
@given(
    st.floats(2.3, 7.0),
    st.floats(0.0, 0.9),
    st.integers(2, 5),
    st.tuples(st.floats(-0.95, 0.95), st.floats(-0.95, 0.95)),
    st.tuples(st.floats(0.3, 2.0), st.floats(0.3, 2.0)),
)
def test_cones_are_not_flat_exactly_where_they_hold_their_apex(k, share, n, apex, size):
    k = round(k, 2)
    # The form is definite while k g + g'' > (1 - 1/k) g'^2 / g.
    a = round(share * 0.8 * min(0.5, k / (n * n)), 3)
    source = Cone(k, a, n, apex)
    assume(source.hessian(*np.random.default_rng(0).uniform(-1, 1, (2, 500)))[:, 0, 0].min() > 0)
    result = flatness(source, AROUND)
    assert result.apexes[0].where == pytest.approx(apex, abs=1e-8)
    assert result.apexes[0].angle == pytest.approx(source.angle, rel=1e-6)
    back = math.remainder(source.angle, 2 * math.pi)
    assert result.flat == (abs(back) < 1e-6)
    assert result.apexes[0].mismatch == pytest.approx(2 * abs(math.sin(back / 2)), rel=0.5)
    # Beside the apex, above it, and with it on a corner and on an edge of the closed domain.
    (x, y), (w, h) = apex, size
    assert flatness(source, (x + 0.01 * w, y - h, x + w, y + h)).flat
    assert flatness(source, (x - w, y + 0.01 * h, x + w, y + h)).flat
    assert flatness(source, (x, y, x + w, y + h)).flat == result.flat
    assert flatness(source, (x, y - h, x + w, y + h)).flat == result.flat


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.integers(1, 2)),
        min_size=1,
        max_size=3,
    )
)
def test_harmonic_functions_are_flat_unless_a_loop_about_a_zero_reverses_y(zeros):
    # f = Re F with F'' = product of (z - z_k)^m_k: y = integral of sqrt(F'').
    places = np.array([complex(x, y) for x, y, _ in zeros])
    gaps = np.abs(np.subtract.outer(places, places)) + 9 * np.eye(len(places))
    assume(gaps.min() > 0.15)
    roots = np.repeat(places, [m for *_, m in zeros])
    second = np.polynomial.Polynomial.fromroots(roots)
    third = second.deriv()

    class Source:
        def hessian(self, x, y):
            # As a product, which keeps its digits near the zeros.
            d = np.prod([x + 1j * y - z for z in roots], axis=0)
            return np.stack([np.stack([d.real, -d.imag], -1), np.stack([-d.imag, -d.real], -1)], -2)

        def third(self, x, y):
            d = third(x + 1j * y)
            return np.stack([d.real, -d.imag, -d.real, d.imag], axis=-1)

    result = flatness(Source(), AROUND)
    assert len(result.apexes) == len(zeros)
    for apex in result.apexes:
        k = np.abs(places - complex(*apex.where)).argmin()
        assert abs(places[k] - complex(*apex.where)) < 1e-5
        m = zeros[k][2]
        assert apex.angle == pytest.approx((m + 2) * math.pi, rel=1e-6)
        assert apex.mismatch == pytest.approx(2.0 * (m % 2), abs=1e-5)
    assert result.flat == all(m == 2 for *_, m in zeros)
    assert result.flat or result.cause == "apex"


@pytest.mark.parametrize("n", range(3, 9))
@pytest.mark.parametrize("domain", [AROUND, (0.3, 0.2, 1, 1), (0.3, -1, 1, 1)])
def test_powers_in_expanded_form_have_their_angle_too(n, domain):
    x, y = sympy.symbols("x y", real=True)
    z = x - sympy.Rational(3, 10) + sympy.I * (y - sympy.Rational(1, 5))
    text = str(sympy.expand(sympy.re(sympy.expand(z**n))))
    result = flatness(text, domain)
    assert result.flat == (n % 2 == 0)
    if not result.flat:
        # Rounding of the coefficients hides the place of a zero of high order.
        assert result.where == pytest.approx((0.3, 0.2), abs=1e-3)
        assert result.apexes[0].angle == pytest.approx(n * math.pi, rel=1e-6)


@pytest.mark.parametrize(
    "source,cause,curve",
    [
        ("x**3+y**2", "sign", shapely.LineString([(0, -1), (0, 1)])),
        ("(x-0.313)**3/6+y**2", "sign", shapely.LineString([(0.313, -1), (0.313, 1)])),
        ("x**4+y**2", "curve", shapely.LineString([(0, -1), (0, 1)])),
        ("(x-0.313)**4+y**2", "curve", shapely.LineString([(0.313, -1), (0.313, 1)])),
        ("x**4+y**4", "curve", shapely.LineString([(-1, 0), (1, 0), (0, 0), (0, 1), (0, -1)])),
        ("(x+2*y)**2", "curve", shapely.box(*AROUND)),
        ("x-y", "curve", shapely.box(*AROUND)),
    ],
)
def test_curves_where_the_determinant_vanishes_or_changes_sign_are_found(source, cause, curve):
    result = flatness(source, AROUND)
    assert (result.flat, result.cause) == (False, cause)
    assert curve.distance(shapely.Point(result.where)) < 1e-6
    assert (result.amount > 0.1) == (cause == "sign")
    assert "det H" in str(result)


def test_a_small_island_of_the_other_sign_between_samples_is_found():
    # det H = 2 ((x - a)^2 + (y - b)^2 - r^2) times a constant, where Gamma is not looked at.
    class Island:
        def hessian(self, x, y):
            d = (x - 0.3137) ** 2 + (y - 0.2211) ** 2 - 0.004**2
            zero = np.zeros_like(d)
            return np.stack([np.stack([d, zero], -1), np.stack([zero, zero + 1.0], -1)], -2)

        def third(self, x, y):
            return np.zeros((len(x), 4))

    result = flatness(Island(), SQUARE)
    assert result.cause == "sign"
    distance = np.hypot(result.where[0] - 0.3137, result.where[1] - 0.2211)
    assert distance == pytest.approx(0.004, rel=1e-6)


@pytest.mark.parametrize(
    "source", ["log(x**2+y**2)", "1/((x-0.31)**2+(y+0.22)**2)", "1/(x-y)", "(x**2+y**2)**0.7"]
)
def test_singular_points_are_found(source):
    result = flatness(source, AROUND)
    assert (result.verdict, result.cause) == ("not flat", "singular")
    assert "not finite" in str(result)


def test_a_cone_whose_determinant_does_not_vanish_is_found_by_its_loops():
    # Degree 2: the Hessian is bounded, and has no limit at the apex.
    result = flatness("x**2+y**2+(x**4+y**4)/(x**2+y**2)/10", (-1, -0.9, 1, 1.2))
    assert result.cause == "apex"
    assert np.abs(result.where).max() < 1e-6
    assert result.apexes[0].angle != pytest.approx(2 * math.pi, abs=1e-3)
    assert flatness("x**2+y**2+(x**4+y**4)/(x**2+y**2)/10", (0.1, -0.9, 1, 1.2)).flat


@settings(max_examples=8, deadline=None)
@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(-3, 3))
def test_the_verdict_is_the_same_at_every_scale(log_height, log_x, log_aspect):
    height, sx, sy = (10.0 ** round(v, 1) for v in (log_height, log_x, log_aspect + log_x))
    for source, cause, domain in (
        (QUARTIC, "apex", AROUND),
        (QUARTIC, "", (0.1, 0.1, 1, 1)),
        ("x**3+y**2", "sign", AROUND),
        ("exp(x*y)", "curvature", AROUND),
        ("exp(2*x)*sin(2*y)", "", SQUARE),
    ):
        scaled = source.replace("exp", "EXP").replace("x", f"(x/{sx!r})").replace("EXP", "exp")
        scaled = f"{height!r}*({scaled.replace('y', f'(y/{sy!r})')})"
        box = (domain[0] * sx, domain[1] * sy, domain[2] * sx, domain[3] * sy)
        assert flatness(scaled, box).cause == cause


def test_sums_of_a_function_of_x_and_one_of_y_are_flat():
    assert flatness("cosh(x)+y**4", (-1, 0.1, 1, 1)).flat


def test_the_same_question_has_the_same_answer():
    assert flatness(QUARTIC, AROUND) == flatness(QUARTIC, AROUND)
    assert flatness(FRANKE, SQUARE) == flatness(FRANKE, SQUARE)
