"""Domains: validity, straight sides with their names, strips for point-in-polygon tests."""

import math

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import example, given
from hypothesis import strategies as st

from equimesh.domain import domain_geometry, sides_of, strips_of
from equimesh.errors import InputError
from equimesh.ground import inside

HOLED = shapely.Polygon(
    [(0, 0), (4, 0), (4, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2)], [(3, 2), (3.5, 2), (3.2, 2.5)]]
)
TWO = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])


def star_polygon(seed, corners=12):
    """A random polygon that sees its centre, so it never crosses itself."""
    rng = np.random.default_rng(seed)
    angle = 2 * math.pi * (np.arange(corners) + rng.uniform(0, 0.8, corners)) / corners
    return shapely.Polygon(
        np.stack([np.cos(angle), np.sin(angle)], 1) * rng.uniform(0.3, 1, (corners, 1))
    )


def signed_area(sides):
    """By the divergence theorem over all directed sides: holes count negative."""
    a, b = sides.corners, sides.corners[sides.following]
    return 0.5 * math.fsum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@pytest.mark.parametrize("geometry", [HOLED, TWO, HOLED.reverse(), shapely.box(-1, 2, 5, 3)])
def test_sides_run_with_the_domain_on_their_left(geometry):
    sides = sides_of(geometry)
    assert signed_area(sides) == pytest.approx(geometry.area, rel=1e-14)
    step = sides.corners[sides.following] - sides.corners
    left = np.stack([-step[:, 1], step[:, 0]], 1) / np.hypot(*step.T)[:, None]
    probe = sides.corners + 0.5 * step + 1e-6 * left
    assert shapely.contains_xy(geometry, *probe.T).all()


@given(st.integers(0, 2**32 - 1))
def test_sides_measure_the_area_and_the_perimeter_of_any_polygon(seed):
    polygon = star_polygon(seed)
    sides = sides_of(polygon)
    assert signed_area(sides) == pytest.approx(polygon.area, rel=1e-12)
    step = sides.corners[sides.following] - sides.corners
    assert np.hypot(*step.T).sum() == pytest.approx(polygon.length, rel=1e-12)


def test_an_upright_rectangle_names_its_sides_wherever_its_ring_begins():
    for k in range(4):
        ring = np.roll(np.array([(1, 2), (5, 2), (5, 4), (1, 4)], float), k, axis=0)
        for polygon in (shapely.Polygon(ring), shapely.Polygon(ring[::-1])):
            sides = sides_of(polygon)
            assert sides.names == ("bottom", "right", "top", "left")
            for tag, axis, level in ((0, 1, 2.0), (1, 0, 5.0), (2, 1, 4.0), (3, 0, 1.0)):
                (i,) = np.flatnonzero(sides.tags == tag)
                ends = sides.corners[[i, sides.following[i]], axis]
                assert (ends == level).all()


def test_other_domains_name_outlines_and_holes():
    holed = sides_of(HOLED)
    assert holed.names == ("outline", "hole 1", "hole 2")
    assert np.bincount(holed.tags).tolist() == [4, 3, 3]
    assert sides_of(TWO).names == ("outline 1", "outline 2")
    assert sides_of(shapely.Polygon([(0, 0), (1, 1), (0, 2), (-1, 1)])).names == ("outline",)


def test_following_corners_stay_on_their_own_ring():
    sides = sides_of(shapely.MultiPolygon([HOLED, shapely.box(5, 0, 6, 1)]))
    assert (sides.tags[sides.following] == sides.tags).all()
    assert (np.sort(sides.following) == np.arange(len(sides.following))).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_vertices_on_a_straight_side_are_left_out(seed, cuts):
    rng = np.random.default_rng(seed)
    extra = np.sort(rng.integers(1, 64, cuts)) / 64
    bottom = np.stack([extra, np.zeros(cuts)], 1)
    ring = np.vstack([[(0, 0)], np.unique(bottom, axis=0), [(1, 0), (1, 1), (0, 1)]])
    sides = sides_of(shapely.Polygon(ring))
    assert len(sides.corners) == 4
    assert sides.names == ("bottom", "right", "top", "left")


@pytest.mark.parametrize(
    "domain",
    [
        None,
        (0, 0, 1),
        (0, 0, 1, "a"),
        (0, 0, math.inf, 1),
        (0, 0, math.nan, 1),
        (1, 0, 0, 1),
        (0, 0, 1, 0),
        shapely.Point(0, 0),
        shapely.LineString([(0, 0), (1, 1)]),
        shapely.Polygon(),
        shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]),
        shapely.Polygon([(0, 0), (1, 0), (1, 1)], [[(2, 2), (3, 2), (3, 3)]]),
        shapely.Polygon([(0, 0), (1, 0), (2, 0)]),
        shapely.Polygon([(0, 0), (1, 0), (1, 1e-15)]),
    ],
)
def test_what_is_no_domain_is_refused_in_one_sentence(domain):
    with pytest.raises(InputError) as caught:
        domain_geometry(domain)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_heights_of_a_polygon_are_dropped():
    solid = shapely.Polygon([(0, 0, 5), (1, 0, 6), (0, 1, 7)])
    assert not domain_geometry(solid).has_z


@given(st.integers(0, 2**32 - 1))
@example(0)
def test_strips_find_the_same_points_inside_as_shapely(seed):
    polygon = shapely.difference(
        star_polygon(seed), shapely.affinity.scale(star_polygon(seed + 1), 0.2, 0.2)
    )
    sides = sides_of(polygon)
    segments = np.hstack([sides.corners, sides.corners[sides.following]])
    strips = strips_of(segments)
    points = np.random.default_rng(seed).uniform(-1.2, 1.2, (300, 2))
    far = shapely.distance(polygon.boundary, shapely.points(points)) > 1e-9
    ours = np.array([inside(segments, *strips, x, y) for x, y in points])
    assert (ours == shapely.contains_xy(polygon, *points.T))[far].all()
