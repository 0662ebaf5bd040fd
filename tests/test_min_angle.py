"""The floor for angles: kept, at a known price, except where corners are sharper."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

import equimesh
from equimesh.angle_price import largest_areas
from equimesh.angles import AngleFloor
from equimesh.domain import sides_of

WAVES = "sin(3*x) * cos(4*y) + x*y"


def smallest(result: equimesh.Result) -> np.ndarray:
    """(m, 3) the angles of every triangle, by the law of cosines."""
    p = result.points[result.triangles, :2]
    a, b, c = (np.hypot(*(p[:, (k + 1) % 3] - p[:, (k + 2) % 3]).T) for k in range(3))
    sides = np.stack([a, b, c], 1)
    cosines = [
        (sides[:, (k + 1) % 3] ** 2 + sides[:, (k + 2) % 3] ** 2 - sides[:, k] ** 2)
        / (2 * sides[:, (k + 1) % 3] * sides[:, (k + 2) % 3])
        for k in range(3)
    ]
    return np.degrees(np.arccos(np.stack(cosines, 1)))


@pytest.fixture(scope="module")
def free():
    """The mesh without a floor."""
    return equimesh.remesh(WAVES, 0.01, (0, 0, 2, 2))


@pytest.mark.parametrize("floor", [15, 25])
def test_the_floor_is_kept_at_a_small_price(free: equimesh.Result, floor: float) -> None:
    kept = equimesh.remesh(WAVES, 0.01, (0, 0, 2, 2), min_angle=floor)
    assert kept.status.ok
    assert kept.profile.bound <= 0.01
    assert smallest(free).min() < floor <= smallest(kept).min()
    assert len(kept.triangles) <= 1.35 * kept.lower_bound
    assert any(f"min_angle={floor}" in note for note in kept.notes)


def test_same_bytes_twice() -> None:
    one, two = (equimesh.remesh(WAVES, 0.02, (0, 0, 1, 1), min_angle=20) for _ in range(2))
    assert one.points.tobytes() == two.points.tobytes()


def test_the_floor_holds_in_the_users_coordinates() -> None:
    y, x = np.mgrid[0:30, 0:40]
    z = np.sin(x / 6.0) * np.cos(y / 9.0)
    stretched = equimesh.Raster(z, transform=(3.0, 0.0, 100.0, 0.0, -0.5, 50.0))
    result = equimesh.remesh(stretched, "2%", min_angle=15)
    assert result.status.ok
    assert smallest(result).min() >= 15


def test_surfaces_keep_it() -> None:
    rng = np.random.default_rng(1)
    xy = np.vstack([rng.random((600, 2)), [(0, 0), (1, 0), (0, 1), (1, 1)]])
    z = np.sin(3 * xy[:, 0]) * xy[:, 1]
    triangles = np.array(
        [[np.flatnonzero((xy == c).all(1))[0] for c in shapely.get_coordinates(t)[:3]]
         for t in shapely.get_parts(shapely.delaunay_triangles(shapely.MultiPoint(xy)))]
    )  # fmt: skip
    result = equimesh.remesh(
        equimesh.Surface(np.column_stack([xy, z]), triangles), "5%", min_angle=15
    )
    assert result.profile.bound <= result.tol
    assert result.status.ok or "min_angle" in result.status.value


def test_a_sharp_corner_is_its_own_floor() -> None:
    needle = shapely.Polygon([(0, 0), (1, 0), (1, 0.1)])
    result = equimesh.remesh(WAVES, 0.005, needle, min_angle=15)
    assert result.status.ok
    angles = smallest(result)
    t, k = np.nonzero(angles < 15)
    assert (result.points[result.triangles[t, k], :2] == 0).all()
    assert angles.min() >= 0.99 * math.degrees(math.atan(0.1))


def test_a_plane_on_a_strip_is_cut_into_triangles_with_the_floor() -> None:
    assert len(equimesh.remesh("x + y", 0.1, (0, 0, 50, 1)).triangles) == 2
    result = equimesh.remesh("x + y", 0.1, (0, 0, 50, 1), min_angle=15)
    assert result.status.ok
    assert smallest(result).min() >= 15
    # Triangles of height 1 with two angles of 15 degrees have the area 1 / tan 15.
    assert 50 * math.tan(math.radians(15)) <= len(result.triangles) < 60


def test_sectors_of_corners_and_constraints() -> None:
    sides = sides_of(shapely.Polygon([(0, 0), (1, 0), (1, 0.1), (0.5, 0.1), (0.5, 1), (0, 1)]))
    floor = AngleFloor.of(30.0, sides)
    assert len(floor.angles) == 0  # reflex and right angles
    floor = AngleFloor.of(30.0, sides_of(shapely.Polygon([(0, 0), (1, 0), (1, 0.1)])))
    assert np.allclose(floor.corners, [(0, 0)])
    assert math.isclose(floor.angles[0], math.degrees(math.atan(0.1)))


def test_the_price_is_that_of_the_best_triangle() -> None:
    shares = largest_areas(math.radians(15))
    assert np.allclose(shares[:, 0], 1.0)  # equilateral or nearly: no price
    assert (np.diff(shares, axis=1) < 0.03).all()
    # Across a cylinder the best one has angles 15, 15, 150 and the area 1 / tan(15).
    ratio = math.exp(-0.35 * 31)
    free = 3 * math.sqrt(3) / 16 / math.sqrt(ratio)
    assert math.isclose(shares[1, 31] * free, 1 / math.tan(math.radians(15)), rel_tol=0.02)


@pytest.mark.parametrize("angle", [0, -3, 31, math.nan, "wide", True])
def test_floors_that_cannot_be(angle: object) -> None:
    with pytest.raises(equimesh.InputError, match="min_angle="):
        equimesh.remesh("x*y", 0.1, (0, 0, 1, 1), min_angle=angle)  # type: ignore[arg-type]


def test_metrics_take_none() -> None:
    metric = equimesh.Metric.isotropic(0.2)
    with pytest.raises(equimesh.InputError, match="min_angle="):
        equimesh.remesh(metric, domain=(0, 0, 1, 1), min_angle=15)
