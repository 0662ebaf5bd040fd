"""Breaklines are edges of the mesh, points its vertices, wherever they lie and cross."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.errors import InputError
from equimesh.noding import noded

BOX = (0.0, 0.0, 1.0, 1.0)
HOLED = shapely.box(*BOX).difference(shapely.box(0.4, 0.4, 0.6, 0.6))
WAVE = "sin(4*x)*cos(3*y)"


def edges_of(result):
    t = result.triangles
    sides = np.vstack([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    return np.unique(np.sort(sides, 1), axis=0)


def uncovered(result, line):
    """How far the edges along a line are from adding up to it, and it from them; 0: covered."""
    ends = result.points[edges_of(result)][:, :, :2]
    edges = shapely.linestrings(ends)
    size = np.ptp(result.points[:, :2], axis=0).max()
    along = edges[shapely.covers(shapely.buffer(line, 1e-9 * size), edges)]
    once = shapely.length(shapely.union_all(line)) if line.is_simple else None
    gap = shapely.length(line.difference(shapely.union_all(shapely.buffer(along, 1e-9 * size))))
    return max(gap, abs(once - shapely.length(along).sum()) if once else 0.0)


def meets(result, lines, domain, tol):
    """The whole contract: a valid cover within the tolerance that contains every line."""
    a, b, c = (result.points[result.triangles[:, k], :2] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx(domain.area, rel=1e-9)
    assert result.status.ok
    assert result.profile.bound <= tol
    size = np.ptp(result.points[:, :2], axis=0).max()
    for line in lines:
        for part in shapely.get_parts(line.intersection(domain)):
            if part.length > 0.0:
                assert uncovered(result, part) <= 1e-8 * size
    known = {tuple(edge) for edge in edges_of(result).tolist()}
    assert {tuple(sorted(edge)) for edge in result.constraints.edges.tolist()} <= known


def remesh(lines, domain=BOX, tol=0.02, source=WAVE, **options):
    return equimesh.remesh(source, tol, domain, constraints=lines, effort="fast", **options)


coordinate = st.integers(-4, 20).map(lambda k: k / 16.0)
polyline = st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=5, unique=True)


@given(st.lists(polyline, min_size=1, max_size=6))
@settings(max_examples=40, deadline=None)
def test_random_lines_on_a_grid_of_coincidences(lines):
    """Common points, overlaps, lines along the sides and through the hole."""
    shapes = [shapely.LineString(line) for line in lines]
    try:
        result = remesh(shapes, HOLED, 0.05)
    except InputError:
        assert shapely.union_all(shapes).intersection(HOLED).length == 0.0
        return
    meets(result, shapes, HOLED, 0.05)
    wanted = shapely.union_all(shapes).intersection(HOLED)
    length = np.linalg.norm(
        np.diff(result.points[result.constraints.edges], axis=1)[:, 0, :2], axis=1
    )
    assert length.sum() == pytest.approx(wanted.length, rel=1e-9)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_random_lines_in_general_position(number):
    ends = np.random.default_rng(number).uniform(-0.2, 1.2, (12, 2, 2))
    lines = [shapely.LineString(end) for end in ends]
    meets(remesh(lines, HOLED), lines, HOLED, 0.02)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate, coordinate), min_size=1, max_size=12))
@settings(max_examples=200, deadline=None)
def test_noding_keeps_the_set_and_leaves_common_ends_only(rows):
    ends = np.array(rows).reshape(-1, 2)
    segments = np.arange(len(ends)).reshape(-1, 2)
    points, index, pieces, owner = noded(ends, segments, 1e-12)
    assert (index[index] == index).all()
    lines = shapely.linestrings(points[pieces])
    whole = shapely.linestrings(ends[segments])
    whole = whole[shapely.length(whole) > 0.0]
    assert shapely.length(shapely.union_all(lines)) == pytest.approx(
        shapely.length(shapely.union_all(whole)), abs=1e-9
    )
    _, first = np.unique(np.sort(pieces, 1), axis=0, return_index=True)
    for i in first:
        for j in first[first > i]:
            met = shapely.intersection(lines[i], lines[j])
            assert met.length <= 1e-9
            assert len(np.intersect1d(pieces[i], pieces[j])) <= 1
    assert (np.diff(owner) >= 0).all()


def test_points_are_vertices_to_the_last_bit():
    rng = np.random.default_rng(5)
    spots = np.vstack([rng.random((20, 2)), [[0.3, 0.0], [1.0, 0.7], [1.0, 1.0]]])
    result = remesh({"wells": shapely.MultiPoint(spots)})
    meets(result, [], shapely.box(*BOX), 0.02)
    found = result.points[result.constraints.points, :2]
    assert {tuple(p) for p in found} == {tuple(p) for p in spots}
    assert result.constraints.names == ("wells",)


def test_vertices_of_lines_stay_to_the_last_bit_in_map_coordinates():
    origin = np.array([5_412_345.678, 601_234.567])
    z = np.add.outer(np.sin(np.arange(40) / 5.0), np.cos(np.arange(50) / 7.0))
    raster = equimesh.Raster(z, transform=(0.1, 0.0, origin[0], 0.0, 0.1, origin[1]))
    line = origin + np.array([[0.512345, 0.412345], [3.3, 1.2345678], [4.1, 3.1]])
    result = equimesh.remesh(raster, "3%", constraints=[line], effort="fast")
    vertices = {tuple(p) for p in result.points[:, :2]}
    assert {tuple(p) for p in line} <= vertices
    assert result.status.ok


@pytest.mark.parametrize(
    "line",
    [
        [(0.2, 0.0), (0.7, 0.0)],  # along a side
        [(0.0, 0.3), (0.5, 0.3), (0.5, 0.0)],  # from side to side
        [(0.0, 0.0), (1.0, 1.0)],  # from corner to corner
        [(-1.0, 0.0), (2.0, 0.0)],  # along a whole side and beyond
        [(0.3, 0.3), (0.3, 0.3), (0.4, 0.8)],  # a point twice
        [(0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8), (0.2, 0.2)],  # closed
        [(0.1, 0.1), (0.9, 0.9), (0.1, 0.9), (0.9, 0.1)],  # across itself
    ],
)
def test_lines_at_the_boundary(line):
    shape = shapely.LineString(line)
    meets(remesh([line]), [shape], shapely.box(*BOX), 0.02)


def test_a_line_through_a_hole_is_cut():
    line = shapely.LineString([(0.0, 0.5), (1.0, 0.5)])
    result = remesh({"road": line}, HOLED)
    meets(result, [line], HOLED, 0.02)
    x = result.points[result.constraints.edges_of("road"), 0]
    assert not ((x.mean(1) > 0.4) & (x.mean(1) < 0.6)).any()


def test_duplicates_and_near_ones_are_one_line():
    line = np.array([(0.1, 0.2), (0.8, 0.7)])
    once, more = remesh([line]), remesh([line, line[::-1], line + 1e-15])
    assert len(more.triangles) == len(once.triangles)
    assert len(more.constraints.edges) == len(once.constraints.edges)


def test_names_are_kept_where_lines_overlap():
    lines = {"road": [[(0.1, 0.5), (0.7, 0.5)]], "wall": [[(0.4, 0.5), (0.9, 0.5)]]}
    result = remesh(lines)
    for name, (low, high) in {"road": (0.1, 0.7), "wall": (0.4, 0.9)}.items():
        x = result.points[result.constraints.edges_of(name), 0]
        assert x.min() == low
        assert x.max() == high
        assert np.abs(np.diff(x)).sum() == pytest.approx(high - low)
    curves = result.curves
    assert len(np.unique(np.sort(curves.edges, 1), axis=0)) == len(curves.edges)
    assert set(curves.names) == {"bottom", "right", "top", "left", "road", "wall"}


def test_a_line_on_the_boundary_keeps_both_names():
    result = remesh({"kerb": [[(0.25, 0.0), (0.75, 0.0)]]})
    x = result.points[result.constraints.edges_of("kerb")]
    assert x[:, :, 1].max() == 0.0
    assert np.abs(np.diff(x[:, :, 0])).sum() == pytest.approx(0.5)
    bottom = result.points[result.boundary.edges_of("bottom")]
    assert np.abs(np.diff(bottom[:, :, 0])).sum() == pytest.approx(1.0)


def test_without_need_a_line_costs_no_vertex():
    result = remesh([[(0.25, 0.25), (0.75, 0.5)]], source="x + 2*y")
    assert len(result.points) == 6
    assert len(result.constraints.edges) == 1


def test_superfluous_vertices_on_lines_are_removed():
    """A mesh of a raster with a line has hardly more triangles than the line's ends ask for."""
    y, x = np.mgrid[0:60, 0:80] / 20.0
    z = np.sin(2 * x) * np.cos(2 * y)
    line = [(3.3, 4.4), (71.2, 52.9)]
    plain = equimesh.remesh(z, "1%", effort="fast")
    lined = equimesh.remesh(z, "1%", effort="fast", constraints=[line])
    assert lined.status.ok
    assert uncovered(lined, shapely.LineString(line)) <= 1e-7
    assert len(lined.triangles) <= 1.25 * len(plain.triangles)


def test_rasters_bound_the_error_beside_lines_off_the_samples():
    rng = np.random.default_rng(3)
    z = rng.normal(size=(30, 40)).cumsum(0).cumsum(1)
    lines = [shapely.LineString(rng.uniform(-2, 42, (3, 2))) for _ in range(12)]
    result = equimesh.remesh(z, "2%", effort="fast", constraints=lines)
    meets(result, lines, shapely.box(0, 0, 39, 29), result.tol)
    again = equimesh.remesh(z, "2%", effort="fast", constraints=lines)
    assert np.array_equal(result.points, again.points)


def test_what_lies_outside_is_left_out_and_said():
    inside, outside = [(0.1, 0.1), (0.5, 0.5)], [(2.0, 2.0), (3.0, 3.0)]
    result = remesh([inside, outside])
    assert result.notes == ("1 of 2 constraints lie outside the domain",)


@pytest.mark.parametrize(
    "constraints, word",
    [
        ([[(0.0, np.nan), (1.0, 1.0)]], "finite"),
        ([shapely.LineString()], "empty"),
        ([[]], "no line"),
        ([[(2.0, 2.0), (3.0, 2.0)]], "outside"),
        ([shapely.Point(5, 5)], "outside"),
        ([shapely.box(0, 0, 1, 1)], "Polygon"),
        ({"left": [[(0.1, 0.1), (0.5, 0.5)]]}, "left"),
        ([3.0], "no line"),
        (7, "int"),
        ("nowhere.geojson", "no file"),
    ],
)
def test_errors_are_sentences(constraints, word):
    with pytest.raises(InputError, match=word) as caught:
        remesh(constraints)
    assert str(caught.value).endswith(".")


def test_geojson_with_names(tmp_path):
    path = tmp_path / "lines.geojson"
    line, spot = shapely.LineString([(0.1, 0.1), (0.9, 0.4)]), shapely.Point(0.3, 0.8)
    features = [
        {"type": "Feature", "properties": {"name": "dyke"}, "geometry": json.loads(line_text)}
        for line_text in [shapely.to_geojson(line)]
    ] + [{"type": "Feature", "properties": None, "geometry": json.loads(shapely.to_geojson(spot))}]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    result = remesh(str(path))
    meets(result, [line], shapely.box(*BOX), 0.02)
    assert result.constraints.names == ("dyke", "breaklines")
    assert (0.3, 0.8) in {tuple(p) for p in result.points[:, :2]}
    for text in ("{", "[]", '{"type": "Feature"}', '{"type": "FeatureCollection", "features": []}'):
        path.write_text(text)
        with pytest.raises(InputError, match="file"):
            remesh(path)


def test_shapefiles(tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    path = tmp_path / "lines.shp"
    line = shapely.LineString([(0.1, 0.1), (0.9, 0.4)])
    pyogrio.raw.write(
        path, np.array([shapely.to_wkb(line)], object), [np.array(["dyke"], object)], ["name"],
        geometry_type="LineString", driver="ESRI Shapefile", crs="EPSG:32632",
    )  # fmt: skip
    result = remesh(path)
    meets(result, [line], shapely.box(*BOX), 0.02)
    assert result.constraints.names == ("dyke",)


def test_named_lines_reach_other_programs(tmp_path):
    import meshio

    from equimesh import formats

    lines = {"road": [[(0.1, 0.5), (0.7, 0.55)]], "wall": [[(0.4, 0.2), (0.45, 0.9)]]}
    result = remesh(lines)
    wanted = {name: len(result.curves.edges_of(name)) for name in lines}
    formats.save(tmp_path / "mesh.vtu", result)
    formats.save(tmp_path / "mesh.mesh", result)
    text = (tmp_path / "mesh.mesh").read_text().split()
    assert int(text[text.index("Edges") + 1]) == len(result.curves.edges)
    import equimesh_adapters.meshio as adapter

    mesh = adapter.from_result(result)
    for name, count in wanted.items():
        assert len(mesh.cell_sets[name][1]) == count
    assert isinstance(mesh, meshio.Mesh)


def test_gmsh_has_a_physical_group_for_every_name(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    from equimesh import formats

    lines = {"road": [[(0.1, 0.5), (0.7, 0.55)], [(0.7, 0.55), (1.0, 0.2)], [(0.7, 0.55), (1, 1)]]}
    result = remesh(lines)
    path = tmp_path / "mesh.msh"
    formats.save(path, result)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        groups = {
            gmsh.model.getPhysicalName(1, tag): tag for _, tag in gmsh.model.getPhysicalGroups(1)
        }
        entities = gmsh.model.getEntitiesForPhysicalGroup(1, groups["road"])
        count = sum(len(gmsh.model.mesh.getElementsByType(1, tag)[0]) for tag in entities)
    finally:
        gmsh.finalize()
    assert count == len(result.curves.edges_of("road"))
