"""Norms of the error: closed forms, rates, and independent measurements."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

import equimesh
from equimesh.domain import domain_geometry
from equimesh.fields import as_field
from equimesh.norms.densities import gradient_area, least_triangles
from equimesh.norms.measure import norm_profile

BOX = (0.0, 0.0, 1.0, 1.0)
ONE = np.array([[0, 1, 2]])


def test_integrals_of_one_triangle() -> None:
    """Of x^2 + y^2 on an equilateral triangle with edges l: l^2 A / 4 and l^4 A / 15."""
    points = np.array([[0, 0, 0], [1, 0, 1], [0.5, 0.75**0.5, 1.0]])
    area = 3**0.5 / 4
    f = as_field("x^2 + y^2", domain_geometry(BOX))
    assert math.isclose(norm_profile(f, points, ONE, "L1").max, area / 4, rel_tol=1e-12)
    assert math.isclose(norm_profile(f, points, ONE, "L2").max, (area / 15) ** 0.5, rel_tol=1e-12)
    # grad e = 2 (x - centre), largest at a corner: twice the circumradius.
    steep = norm_profile(f, points, ONE, "gradient")
    assert math.isclose(steep.max, 2 / 3**0.5, rel_tol=1e-9)
    assert steep.max <= steep.bound <= 1.01 * steep.max


def test_kinks_of_the_absolute_error_are_resolved() -> None:
    """Of x y on the unit square's upper half: the error x y - x is all of one sign."""
    points = np.array([[0, 0, 0], [1, 1, 1], [0, 1, 0]], float)
    p = norm_profile(as_field("x*y", domain_geometry(BOX)), points, ONE, "L1")
    assert math.isclose(p.max, 1 / 6 - 1 / 8, rel_tol=1e-9)
    # A saddle whose error changes sign: brute force agrees within the bound.
    points = np.array([[0, 0, 0], [1, 0, 0], [0.2, 1, 0.2]], float)
    p = norm_profile(as_field("x*y", domain_geometry(BOX)), points, ONE, "L1")
    n = 800
    i, j = (a.ravel() + 1 / 3 for a in np.meshgrid(np.arange(n), np.arange(n)))
    u, v = i[i + j < n] / n, j[i + j < n] / n
    x, y = u + 0.2 * v, v
    assert abs(p.max - 0.5 * np.abs(x * y - 0.2 * v).mean()) < 2e-3 * p.max


@pytest.mark.parametrize(
    "norm, text, least",
    [
        ("L1", "x^2 + y^2", 2 / (2 * 3**0.5)),
        ("L2", "x^2 + y^2", 2 * (4 / 45) ** 0.5),
        ("L1", "x*y", 1 / 12),
        ("L2", "x*y", 1 / 90**0.5),
    ],
)
def test_lower_bounds_of_quadratics_and_meshes_near_them(
    norm: str, text: str, least: float
) -> None:
    surface, box = as_field(text, domain_geometry(BOX)), domain_geometry(BOX)
    assert math.isclose(least_triangles(surface, box, norm, 1.0), least, rel_tol=1e-3)
    tol = least / 500
    result = equimesh.remesh(text, tol, BOX, norm=norm)
    assert result.status.ok
    assert 0.95 * tol <= result.profile.bound <= tol
    assert math.isclose(result.lower_bound, 500, rel_tol=1e-3)
    assert 0.98 * 500 <= len(result.triangles) <= 1.15 * 500


def test_gradient_areas() -> None:
    assert math.isclose(gradient_area(np.array([1.0]))[0], 3 * 3**0.5 / 4)
    assert np.allclose(gradient_area(np.array([0.0, -0.5, -1.0])), 1.0)


def test_rates() -> None:
    """The integrals fall like 1 / N, the gradient like 1 / sqrt(N)."""
    f = "exp(x + y/2) + x^2 + y^2"
    for norm, tols, power in (("L2", (4e-3, 1e-3), 1.0), ("gradient", (0.8, 0.4), 2.0)):
        some, more = (equimesh.remesh(f, tol, BOX, norm=norm) for tol in tols)
        growth = math.log(len(more.triangles) / len(some.triangles)) / math.log(tols[0] / tols[1])
        assert some.status.ok
        assert more.status.ok
        assert 0.75 * power < growth < 1.25 * power


def test_fewer_triangles_than_a_mesh_of_the_largest_error() -> None:
    """On a bump whose curvature varies, at the same L2 error measured alike."""
    bump = "exp(-20*((x - 0.3)^2 + (y - 0.4)^2))"
    surface = as_field(bump, domain_geometry(BOX))
    largest = equimesh.remesh(bump, 0.004, BOX)
    reached = norm_profile(surface, largest.points, largest.triangles, "L2").bound
    result = equimesh.remesh(bump, reached, BOX, norm="L2")
    assert result.status.ok
    assert len(result.triangles) < 0.95 * len(largest.triangles)


@pytest.mark.parametrize(
    "options, words",
    [
        ({"norm": "L3"}, "unknown"),
        ({"norm": "L2", "tol": "1%"}, "positive number"),
        ({"norm": "L2", "tol": -1.0}, "positive number"),
        ({"norm": "L2", "fit": "best"}, "fit="),
        ({"norm": "L2", "min_angle": 15}, "min_angle="),
        ({"norm": "L2", "constraints": [[(0.1, 0.1), (0.9, 0.5)]]}, "constraints="),
        ({"norm": "L2", "domain": None}, "domain"),
    ],
)
def test_options_that_make_no_sense(options: dict, words: str) -> None:
    given = {"tol": 0.1, "domain": BOX, **options}
    with pytest.raises(equimesh.InputError, match=words):
        equimesh.remesh("x*y", **given)


def test_data_have_no_norm() -> None:
    with pytest.raises(equimesh.InputError, match="for functions"):
        equimesh.remesh(np.zeros((5, 5)), 0.1, shapely.box(0, 0, 4, 4), norm="L2")


def test_a_result_is_one_line() -> None:
    result = equimesh.remesh("x*y", 0.01, BOX)
    said = repr(result)
    assert "\n" not in said
    assert len(said) < 120
    assert "CONVERGED" in said
    assert f"{len(result.triangles):,} triangles" in said
