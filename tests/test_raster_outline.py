"""What a raster with gaps is meshed over: samples covered and left out, one by one."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

import equimesh
from equimesh.errors import InputError
from equimesh.fields.raster import Raster

few = settings(max_examples=60, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def patchy(seed, rows=24, columns=31):
    """Heights with gaps of all sizes, at least one cell left."""
    rng = np.random.default_rng(seed)
    width = rng.choice([0.0, 0.7, 1.5, 4.0])
    noise = gaussian_filter(rng.normal(size=(rows, columns)), width)
    heights = np.where(noise < np.quantile(noise, rng.uniform(0.05, 0.7)), np.nan, noise)
    heights[:2, :2] = 1.0
    return heights


def covered(outline, shape):
    """(rows, columns) whether each sample lies in the closed outline, in (column, row)."""
    shapely.prepare(outline)
    return shapely.intersects_xy(outline, *np.meshgrid(np.arange(shape[1]), np.arange(shape[0])))


def rings(geometry):
    return shapely.get_rings(shapely.get_parts(geometry))


def corner_count(geometry):
    return shapely.get_num_coordinates(geometry) - len(rings(geometry))


@few
@given(seeds)
def test_simplified_outline_holds_the_samples_of_cells_and_no_others(seed):
    field = Raster(patchy(seed))
    outline = field.outline(1.0)
    assert outline.is_valid
    assert np.array_equal(covered(outline, field.heights.shape), np.isfinite(field.heights))


@few
@given(seeds)
def test_simplified_outline_holds_all_cells_and_keeps_their_topology(seed):
    field = Raster(patchy(seed))
    outline, cells = field.outline(1.0), field.outline(0.0)
    assert shapely.difference(cells, outline).area < 1e-9
    assert len(shapely.get_parts(outline)) == len(shapely.get_parts(cells))
    assert len(rings(outline)) == len(rings(cells))
    assert corner_count(outline) <= corner_count(cells)
    corners = shapely.get_coordinates(outline)
    assert np.isfinite(field.value(*corners.T)).all()


def test_a_diagonal_staircase_becomes_one_side():
    row, column = np.indices((40, 60))
    for slope in (1.0, 0.5, 0.31, 2.0):
        field = Raster(np.where(row > slope * column + 3, np.nan, 0.0))
        stairs, straight = corner_count(field.outline(0.0)), corner_count(field.outline(1.0))
        assert straight <= 10 < stairs


def test_a_disc_gets_a_corner_for_every_few_stairs():
    row, column = np.indices((121, 121))
    field = Raster(np.where(np.hypot(row - 60, column - 60) > 55.3, np.nan, 0.0))
    assert 3 * corner_count(field.outline(1.0)) < corner_count(field.outline(0.0))
    exact = np.pi * 55.3**2
    assert field.outline(1.0).area == pytest.approx(exact, rel=0.01)


def test_border_cells_keeps_the_stairs_and_full_rasters_their_rectangle():
    heights = patchy(3)
    kept = Raster(heights, border="cells")
    assert shapely.equals(kept.outline(1.0), kept.outline(0.0))
    full = Raster(np.zeros((7, 9)), (0.1, 0, 5e6, 0, -0.1, 5e6))
    assert corner_count(full.outline(1.0)) == 4


@few
@given(seeds)
def test_outline_follows_the_transform(seed):
    heights = patchy(seed)
    plain = Raster(heights).outline(1.0)
    turned = Raster(heights, (0.3, 0.1, 7.0, -0.2, 0.4, -3.0)).outline(1.0)
    x, y = shapely.get_coordinates(plain).T
    expected = np.stack([0.3 * x + 0.1 * y + 7.0, -0.2 * x + 0.4 * y - 3.0], axis=1)
    assert shapely.get_coordinates(turned) == pytest.approx(expected)


def mesh_covers(result, shape):
    """(rows, columns) whether some triangle of the mesh holds a sample."""
    seen = np.zeros(shape, bool)
    for a, b, c in result.points[result.triangles][:, :, :2]:
        low = np.ceil(np.minimum(np.minimum(a, b), c) - 1e-9).astype(int)
        high = np.floor(np.maximum(np.maximum(a, b), c) + 1e-9).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        inside = np.ones(x.shape, bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) >= -1e-9
        seen[y[inside], x[inside]] = True
    return seen


@pytest.mark.parametrize("bound", ["surface", "samples"])
@pytest.mark.parametrize("border", ["simplified", "cells"])
def test_mesh_covers_every_sample_of_a_cell_and_no_missing_one(bound, border):
    heights = patchy(11, 60, 70)
    field = Raster(heights, bound=bound, border=border)
    result = equimesh.remesh(field, "5%")
    assert result.status.ok
    assert np.array_equal(mesh_covers(result, heights.shape), np.isfinite(field.heights))
    outline = field.outline(result.tol)
    a, b, c = result.points[result.triangles][:, :, :2].transpose(1, 0, 2)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
    assert area == pytest.approx(outline.area, rel=1e-9)
    assert len(result.boundary.names) == len(rings(outline))


def test_samples_of_no_cell_are_left_out_and_told():
    heights = np.zeros((5, 6))
    heights[2, :] = np.nan
    heights[3:, 1:4] = np.nan
    heights[:2, 4] = np.nan
    field = Raster(heights)
    assert field.notes == ("left out 4 samples that belong to no cell with four samples",)
    assert field.left_out == 4
    assert field.bounded("samples").notes[:1] == field.notes
    one = np.zeros((3, 3))
    one[2, :2] = np.nan
    assert Raster(one).notes == ("left out 1 sample that belongs to no cell with four samples",)
    assert Raster(np.zeros((3, 3))).notes == ()


def test_scale_and_offset_are_applied_once():
    stored = np.array([[0, 10, 20], [30, 0, 50], [60, 70, 80], [3, 4, 5]], np.uint8)
    stored[1, 1] = 255
    field = Raster(stored, nodata=255, scale=0.5, offset=-100.0, border="cells")
    plain = np.where(stored == 255, np.nan, 0.5 * stored - 100.0)
    assert np.array_equal(field.heights, Raster(plain).heights, equal_nan=True)
    again = field.bounded("samples")
    assert np.array_equal(field.heights, again.heights, equal_nan=True)
    assert (again.bound, again.border, field.bound) == ("samples", "cells", "surface")


@pytest.mark.parametrize("kind", ["?u1", "i1", "u2", "i4", "u8", "f2", "f4", "f8", ">f4", "<i2"])
def test_any_number_type_will_do(kind):
    values = np.arange(20).reshape(4, 5) % 7
    if kind.startswith("?"):
        with pytest.raises(InputError, match="bool"):
            Raster(values > 3)
        return
    assert np.array_equal(Raster(values.astype(kind)).heights, values)


@pytest.mark.parametrize(
    "options, says",
    [
        ({"bound": "corners"}, "surface or samples"),
        ({"border": "round"}, "simplified or cells"),
        ({"scale": 0.0}, "scale not zero"),
        ({"scale": "a"}, "finite"),
        ({"offset": np.inf}, "finite"),
    ],
)
def test_bad_options_are_told_in_one_sentence(options, says):
    with pytest.raises(InputError, match=says) as caught:
        Raster(np.zeros((3, 3)), **options)
    assert str(caught.value).endswith(".")
    assert ". " not in str(caught.value)


def test_bound_is_for_rasters():
    with pytest.raises(InputError, match="rasters only"):
        equimesh.as_field("x * y", bound="samples")
    assert equimesh.as_field(np.zeros((3, 3)), bound="samples").bound == "samples"
    assert equimesh.as_field("x * y", bound="surface").size == "function"
