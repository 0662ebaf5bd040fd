"""The same terrain in other units, on other maps: the same mesh."""

from __future__ import annotations

import matplotlib.cbook
import numpy as np
import pytest

import equimesh
from equimesh.fields.raster import Raster


@pytest.fixture(scope="module")
def terrain():
    dem = matplotlib.cbook.get_sample_data("jacksboro_fault_dem.npz")
    return dem["elevation"][:90, :110].astype(float)


@pytest.fixture(scope="module")
def plain(terrain):
    return equimesh.remesh(terrain, "5%", effort="fast")


@pytest.mark.parametrize("factor", [1024.0, 2.0**-10, 2.0**40])
def test_heights_in_units_of_powers_of_two_give_the_same_bytes(terrain, plain, factor):
    result = equimesh.remesh(factor * terrain, "5%", effort="fast")
    assert result.triangles.tobytes() == plain.triangles.tobytes()
    assert np.array_equal(result.points, plain.points * [1, 1, factor])
    assert np.array_equal(result.profile.errors, factor * plain.profile.errors)


@pytest.mark.parametrize(
    "transform",
    [
        (8.0, 0, 0, 0, 8.0, 0),
        (0.1, 0, 5e6, 0, 0.1, 5e6),
        (30.0, 0, 500000.0, 0, 30.0, 4649776.5),
        (1 / 1200, 0, -84.41375, 0, 1 / 1200, 36.19625),
    ],
)
def test_map_coordinates_give_the_same_triangles(terrain, plain, transform):
    field = Raster(terrain, transform)
    result = equimesh.remesh(field, "5%", effort="fast")
    assert result.status.ok
    assert np.array_equal(result.triangles, plain.triangles)
    places = field.frame().to_local(result.points[:, :2])
    assert places == pytest.approx(plain.points[:, :2], abs=1e-7)


@pytest.mark.parametrize(
    "transform",
    [
        (0.1, 0, 5e6, 0, -0.1, 5e6),
        (0.09, 0.03, 5e6, -0.02, 0.11, 4e6),
        (0.0, 0.1, 5e6, 0.7, 0.0, 4e6),
    ],
)
def test_turned_and_mirrored_maps_are_meshed_as_well(terrain, plain, transform):
    field = Raster(terrain, transform)
    result = equimesh.remesh(field, "5%", effort="fast")
    assert result.status.ok
    assert len(result.triangles) == pytest.approx(len(plain.triangles), rel=0.05)
    a, b, c = result.points[result.triangles][:, :, :2].transpose(1, 0, 2)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area > 0).all()
    assert area.sum() == pytest.approx(field.outline(1.0).area, rel=1e-6)
    # corners and all samples along the border are within the tolerance too
    rows, columns = terrain.shape
    rim = [(i, j) for i in range(columns) for j in (0, rows - 1)]
    rim += [(i, j) for j in range(rows) for i in (0, columns - 1)]
    profile = equimesh.profile(result.points, result.triangles, field, "samples")
    assert profile.bound <= result.tol
    assert np.isfinite(field.value(*field.frame().to_user(np.array(rim, float)).T)).all()


@pytest.mark.parametrize("factor", [1000.0, 0.001, 1 / 0.3048])
def test_other_units_of_height_give_the_same_mesh(terrain, plain, factor):
    result = equimesh.remesh(factor * terrain, "5%", effort="fast")
    assert result.status.ok
    assert result.tol == pytest.approx(factor * plain.tol)
    assert np.array_equal(result.triangles, plain.triangles)
    assert result.points[:, :2] == pytest.approx(plain.points[:, :2], abs=1e-9)
    assert result.points[:, 2] == pytest.approx(factor * plain.points[:, 2], rel=1e-12)


def test_what_large_coordinates_cannot_tell_from_a_sample_is_the_sample():
    field = Raster(np.arange(12.0).reshape(3, 4), (0.1, 0, 5e6, 0, 0.1, 5e6))
    frame = field.frame()
    samples = np.array([[i, j] for i in range(4) for j in range(3)], float)
    assert np.array_equal(frame.to_local(frame.to_user(samples)), samples)
    between = samples[:6] + 0.3
    assert frame.to_local(frame.to_user(between)) == pytest.approx(between, abs=1e-7)
    assert np.array_equal(field.value(*frame.to_user(samples).T), samples @ [1.0, 4.0])


@pytest.mark.parametrize("factor", [1000.0, 0.001, 1 / 0.3048, 2.0**40])
def test_heights_in_tolerances_do_not_depend_on_their_unit(terrain, factor):
    rough = np.random.default_rng(0).normal(size=(60, 70))
    rough[3:9, 4:8] = np.nan
    for heights in (terrain, rough):
        tol = 0.03 * np.ptp(heights[np.isfinite(heights)])
        plain, low = Raster(heights, bound="samples").in_tolerances(tol)
        scaled, base = Raster(factor * heights, bound="samples").in_tolerances(factor * tol)
        assert np.array_equal(plain.heights, scaled.heights, equal_nan=True)
        assert base == pytest.approx(factor * low)
        assert low + tol * plain.heights == pytest.approx(heights, abs=1e-6 * tol, nan_ok=True)
        assert plain.bound == "samples"
