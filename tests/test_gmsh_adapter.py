"""Gmsh: files that it reopens, models that it has open, and its mesher on equimesh's metric."""

import dataclasses
import hashlib
import sys

import meshio
import numpy as np
import pytest

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters import gmsh as adapter
from equimesh_adapters.gmsh_curved import turned_over

api = pytest.importorskip("gmsh")

SURFACE = "exp(2*x+y) + (x-2*y)**2"
NAMES = ("bottom", "right", "top", "left")
WAVE = "sin(5*x)*cos(4*y)"


@pytest.fixture(scope="module")
def result():
    return equimesh.remesh(SURFACE, tol=0.01, domain=(0, 0, 1 + 1 / 3, 1 + 1 / 7))


@pytest.fixture
def gmsh():
    api.initialize(readConfigFiles=False, interruptible=False)
    api.option.setNumber("General.Terminal", 0)
    api.logger.start()
    yield api
    complaints = [line for line in api.logger.get() if line.startswith(("Warning", "Error"))]
    api.logger.stop()
    api.finalize()
    assert complaints == []


def nodes_of(gmsh, dimension=-1, tag=-1, border=False):
    numbers, places, _ = gmsh.model.mesh.getNodes(dimension, tag, border, False)
    return dict(zip(numbers.tolist(), map(tuple, places.reshape(-1, 3).tolist()), strict=True))


def elements_of(gmsh, kind, tag):
    size = {1: 2, 2: 3, 15: 1}[kind]
    return gmsh.model.mesh.getElementsByType(kind, tag)[1].reshape(-1, size).astype(int)


def groups_of(gmsh):
    """Dimension and entities of every group by its name."""
    return {
        gmsh.model.getPhysicalName(*group): (
            group[0],
            *gmsh.model.getEntitiesForPhysicalGroup(*group),
        )
        for group in gmsh.model.getPhysicalGroups()
    }


def fingerprint(gmsh):
    parts = [repr(nodes_of(gmsh)), repr(gmsh.model.getEntities()), repr(groups_of(gmsh))]
    for entity in gmsh.model.getEntities():
        parts += [
            repr([a.tolist() for a in found]) for found in gmsh.model.mesh.getElements(*entity)[1:]
        ]
    return hashlib.sha256("".join(parts).encode()).hexdigest()  # fmt: skip


def check_conforming(gmsh, tag, area):
    """Every node is used and on the entity below it; the curves' lines are the surface's border."""
    triangles = elements_of(gmsh, 2, tag)
    places = nodes_of(gmsh)
    corners = np.array([[places[n] for n in t] for t in triangles.tolist()])
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    assert twice.min() > 0 or twice.max() < 0
    assert abs(twice.sum()) / 2 == pytest.approx(area, rel=1e-9)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs, count = np.unique(edges, axis=0, return_counts=True)
    border = {tuple(e) for e in pairs[count == 1].tolist()}
    curves = [abs(c) for _, c in gmsh.model.getBoundary([(2, tag)], combined=False)]
    lines = [tuple(sorted(e)) for c in curves for e in elements_of(gmsh, 1, c).tolist()]
    assert len(lines) == len(set(lines))
    assert set(lines) == border
    for curve in curves:
        own = nodes_of(gmsh, 1, curve, border=True)
        assert set(elements_of(gmsh, 1, curve).ravel().tolist()) == set(own)
    used = set(triangles.ravel().tolist())
    owned = set(nodes_of(gmsh, 2, tag, border=True))
    assert used == owned


def square(gmsh, size=1.0, z=0.0):
    tag = gmsh.model.occ.addRectangle(0, 0, z, size, size)
    gmsh.model.occ.synchronize()
    return tag


# Files


@pytest.mark.parametrize("suffix, version", [(".msh", "4.1"), (".msh2", "2.2")])
def test_gmsh_reopens_its_files_with_all_groups(suffix, version, result, gmsh, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    assert path.read_bytes().split(b"\n")[1].startswith(version.encode())
    gmsh.open(str(path))
    groups = groups_of(gmsh)
    assert groups.keys() == {"surface", *NAMES}
    assert {name: group[0] for name, group in groups.items()} == {
        "surface": 2, **dict.fromkeys(NAMES, 1)
    }  # fmt: skip
    places = nodes_of(gmsh)
    for name in NAMES:
        (curve,) = groups[name][1:]
        lines = [[places[n] for n in e] for e in elements_of(gmsh, 1, curve).tolist()]
        np.testing.assert_array_equal(lines, result.points[result.boundary.edges_of(name)])
    faces = [[places[n] for n in t] for t in elements_of(gmsh, 2, groups["surface"][1]).tolist()]
    np.testing.assert_array_equal(faces, result.points[result.triangles])
    gmsh.model.mesh.refine()
    assert len(elements_of(gmsh, 2, groups["surface"][1])) == 4 * len(result.triangles)


@pytest.mark.parametrize("suffix", [".msh", ".msh2"])
def test_files_give_every_bit_back(suffix, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    points, triangles = equimesh_adapters.load_mesh(path)
    np.testing.assert_array_equal(points, result.points)
    np.testing.assert_array_equal(triangles, result.triangles)
    assert not api.isInitialized()


def test_errors_go_along_as_a_view_and_through_meshio(result, gmsh, tmp_path):
    path = tmp_path / "mesh.msh"
    adapter.write(path, result, errors=True)
    gmsh.open(str(path))
    (view,) = gmsh.view.getTags()
    kind, numbers, values, *_ = gmsh.view.getHomogeneousModelData(view, 0)
    assert kind == "ElementData"
    errors = dict(zip(numbers.tolist(), values.tolist(), strict=True))
    triangles = gmsh.model.mesh.getElementsByType(2)[0].tolist()
    assert [errors[n] for n in triangles] == result.profile.errors.tolist()
    mesh = meshio.read(path)
    np.testing.assert_array_equal(mesh.get_cell_data("error", "triangle"), result.profile.errors)
    assert set(mesh.field_data) == {"surface", *NAMES}


def test_version_by_option_and_no_other(result, tmp_path):
    adapter.write(tmp_path / "a.msh", result, version=2.2)
    assert (tmp_path / "a.msh").read_text().startswith("$MeshFormat\n2.2 0 8")
    with pytest.raises(InputError, match=r"4\.1 or 2\.2"):
        adapter.write(tmp_path / "a.msh", result, version=3.0)


def test_a_script_is_not_run_as_a_mesh(tmp_path):
    (tmp_path / "a.msh").write_text(f'SystemCall "touch {tmp_path}/owned";\n')
    with pytest.raises(InputError, match="MeshFormat"):
        equimesh_adapters.load_mesh(tmp_path / "a.msh")
    assert [p.name for p in tmp_path.iterdir()] == ["a.msh"]


def test_a_domain_with_holes_has_closed_curves(gmsh, tmp_path):
    import shapely

    ring = shapely.box(0, 0, 3, 2).difference(shapely.Point(1.5, 1).buffer(0.5))
    result = equimesh.remesh("x*x*y", tol=0.05, domain=ring)
    equimesh_adapters.save(tmp_path / "a.msh", result)
    gmsh.open(str(tmp_path / "a.msh"))
    assert groups_of(gmsh).keys() == {"surface", "outline", "hole 1"}
    assert gmsh.model.getEntities(0) == []
    check_conforming(gmsh, 1, ring.area)


def test_second_order_elements_and_quadrilaterals_are_cut(gmsh, tmp_path):
    square(gmsh)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(tmp_path / "a.msh"))
    field = adapter.to_field()
    assert len(field.triangles) == 4 * len(gmsh.model.mesh.getElementsByType(9)[0])
    read = equimesh_adapters.load_mesh(tmp_path / "a.msh")
    assert len(read.triangles) == len(field.triangles)
    gmsh.model.mesh.setOrder(1)
    gmsh.model.mesh.recombine()
    assert adapter.to_field().outline().area == pytest.approx(1.0)


def test_an_open_session_stays_as_it_was(result, gmsh, tmp_path):
    square(gmsh)
    gmsh.model.mesh.generate(2)
    gmsh.model.add("other")
    square(gmsh, 2.0)
    gmsh.view.add("mine")
    for key, value in (("Mesh.MshFileVersion", 2.2), ("Mesh.SaveAll", 1), ("Mesh.Binary", 0)):
        gmsh.option.setNumber(key, value)
    options = (
        "Mesh.MshFileVersion", "Mesh.SaveAll", "Mesh.Binary", "General.Terminal",
        "PostProcessing.SaveMesh",
    )  # fmt: skip

    def state():
        numbers = [gmsh.option.getNumber(key) for key in options]
        return (
            gmsh.model.list(), gmsh.model.getCurrent(), gmsh.view.getTags().tolist(), numbers,
            fingerprint(gmsh),
        )  # fmt: skip

    before = state()
    equimesh_adapters.save(tmp_path / "a.msh", result)
    equimesh_adapters.load_mesh(tmp_path / "a.msh")
    (tmp_path / "bad.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2\n")
    with pytest.raises(InputError):
        equimesh_adapters.load_mesh(tmp_path / "bad.msh")
    assert state() == before
    api.logger.stop()  # the broken file was complained about
    api.logger.start()


# Models


def test_a_result_becomes_a_model_and_a_field_again(result, gmsh):
    tag = adapter.from_result(result, "terrain", errors=True)
    assert len(gmsh.view.getTags()) == 1
    assert gmsh.model.getCurrent() == "terrain"
    check_conforming(gmsh, tag, (1 + 1 / 3) * (1 + 1 / 7))
    field = adapter.to_field()
    assert len(field.triangles) == len(result.triangles)
    # Vertices may have other numbers, the errors are the same.
    assert adapter.profile(SURFACE).max == pytest.approx(result.profile.max, rel=1e-12)
    with pytest.raises(InputError, match="another name"):
        adapter.from_result(result, "terrain")


@pytest.mark.parametrize("suffix", [".msh", ".msh2"])
def test_a_discrete_surface_is_remeshed_in_place(suffix, result, gmsh, tmp_path):
    equimesh_adapters.save(tmp_path / f"a{suffix}", result)
    gmsh.open(str(tmp_path / f"a{suffix}"))
    groups, field = groups_of(gmsh), adapter.to_field()
    made = adapter.remesh(tol=0.05)
    assert groups_of(gmsh) == groups
    assert made.boundary.names == NAMES
    assert len(elements_of(gmsh, 2, 1)) == len(made.triangles) < len(result.triangles) / 2
    assert adapter.profile(field).bound <= 0.05 * (1 + 1e-9)
    if suffix == ".msh":
        check_conforming(gmsh, 1, (1 + 1 / 3) * (1 + 1 / 7))
    places = nodes_of(gmsh)
    for name, (axis, value) in {
        "bottom": (1, 0), "right": (0, 1 + 1 / 3), "top": (1, 1 + 1 / 7), "left": (0, 0)
    }.items():  # fmt: skip
        (curve,) = groups[name][1:]
        line = np.array([places[n] for n in elements_of(gmsh, 1, curve).ravel().tolist()])
        assert (line[:, axis] == value).all()
        assert len(line) == 2 * len(made.boundary.edges_of(name))
    gmsh.model.mesh.refine()


def test_curves_that_meet_on_a_straight_border_keep_their_joint(result, gmsh):
    boundary = result.boundary
    bottom = result.points[boundary.edges[boundary.tags == 0]].mean(axis=1)[:, 0]
    tags = boundary.tags.copy()
    tags[np.flatnonzero(tags == 0)[bottom > 0.6]] = 4
    split = dataclasses.replace(boundary, tags=tags, names=(*NAMES, "outlet"))
    adapter.from_result(dataclasses.replace(result, boundary=split))
    assert len(gmsh.model.getEntities(0)) == 5
    made = adapter.remesh(tol=0.5)
    check_conforming(gmsh, 1, (1 + 1 / 3) * (1 + 1 / 7))
    assert set(made.boundary.names) == {*NAMES, "outlet"}
    assert all(len(made.boundary.edges_of(name)) for name in made.boundary.names)


def test_a_surface_seen_from_aside_keeps_its_orientation(gmsh):
    tilted = equimesh.remesh("x*x/2 + y*y/3", tol=0.001, domain=(0, 0, 1, 1))
    points = tilted.points[:, [2, 0, 1]]  # heights along x
    turned = dataclasses.replace(tilted, points=points, triangles=tilted.triangles[:, ::-1])
    boundary = dataclasses.replace(tilted.boundary, edges=tilted.boundary.edges[:, ::-1])
    adapter.from_result(dataclasses.replace(turned, boundary=boundary))

    def normals():
        places = nodes_of(gmsh)
        a, b, c = np.array(
            [[places[n] for n in t] for t in elements_of(gmsh, 2, 1).tolist()]
        ).transpose(1, 0, 2)
        return np.cross(b - a, c - a)[:, 0]

    assert (normals() < 0).all()
    made = adapter.remesh(tol=0.02, up="x")
    assert (normals() < 0).all()
    assert len(made.triangles) < len(tilted.triangles) / 4


@pytest.mark.parametrize("meshed", [False, True])
def test_a_plane_surface_with_curved_holes_is_remeshed_in_place(meshed, gmsh):
    g = gmsh.model.geo
    corners = [g.addPoint(x, y, 0.25) for x, y in ((0, 0), (0.5, 0), (1, 0), (1, 1), (0, 1))]
    sides = [g.addLine(corners[i], corners[(i + 1) % 5]) for i in range(5)]
    middle = g.addPoint(0.5, 0.5, 0.25)
    rim = [g.addPoint(0.5 + 0.2 * np.cos(a), 0.5 + 0.2 * np.sin(a), 0.25) for a in (0, 2, 4)]
    arcs = [g.addCircleArc(rim[i], middle, rim[(i + 1) % 3]) for i in range(3)]
    plate = g.addPlaneSurface([g.addCurveLoop(sides), g.addCurveLoop(arcs)])
    g.synchronize()
    gmsh.model.addPhysicalGroup(1, arcs, name="hole")
    gmsh.model.addPhysicalGroup(1, sides[:1], name="inlet")
    gmsh.model.addPhysicalGroup(2, [plate], name="plate")
    if meshed:
        gmsh.model.mesh.generate(2)
    groups = groups_of(gmsh)
    made = adapter.remesh(tol=0.01, follow=WAVE)
    assert groups_of(gmsh) == groups
    assert {"hole", "inlet"} < set(made.boundary.names)
    measured = adapter.profile(WAVE)
    assert measured.bound <= 0.01
    assert len(measured.triangles) == len(made.triangles)
    polygon = sum(
        0.5 * (a[0] - 0.5) * (b[1] - 0.5) - 0.5 * (b[0] - 0.5) * (a[1] - 0.5)
        for a, b in made.points[made.boundary.edges_of("hole")][..., :2]
    )
    check_conforming(gmsh, plate, 1.0 + polygon)  # clockwise: less than nothing
    for arc in arcs:
        places = np.array(list(nodes_of(gmsh, 1, arc, border=True).values()))
        radius = np.hypot(places[:, 0] - 0.5, places[:, 1] - 0.5)
        np.testing.assert_allclose(radius, 0.2, rtol=1e-12)
    assert {p[2] for p in nodes_of(gmsh, 2, plate, border=True).values()} == {0.25}
    gmsh.model.mesh.setOrder(2)  # parameters of nodes on curves are right


def test_no_triangle_of_second_order_turns_over_unseen():
    """Against its Jacobian at many places, from the shape functions."""
    rng = np.random.default_rng(0)
    shares = np.vstack([rng.dirichlet([0.7] * 3, 400), np.eye(3)])
    corners = np.array([[0, 0], [1, 0], [0.3, 0.8]])
    middles = 0.5 * (corners + corners[[1, 2, 0]]) + rng.normal(0, 0.12, (1000, 3, 2))

    def tangents(k):  # (1000, 403, 2), by the share of corner k
        own, following, before = shares[:, [k, (k + 1) % 3, k - 1]].T[..., None]
        bend = following * middles[:, None, k] + before * middles[:, None, k - 1]
        return (4 * own - 1) * corners[k] + 4 * bend

    a, b = tangents(1) - tangents(0), tangents(2) - tangents(0)
    jacobian = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    turned = turned_over(np.broadcast_to(corners, middles.shape), middles)
    least = jacobian.min(1)
    assert 100 < turned.sum() < 900
    assert (least[~turned] > -0.01).all()
    assert (turned[least < -0.01]).all()


def test_orientation_follows_the_surface_and_the_curves(gmsh):
    g = gmsh.model.geo
    corners = [g.addPoint(x, y, 0) for x, y in ((0, 0), (0, 1), (1, 1), (1, 0))]
    sides = [g.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    tag = g.addPlaneSurface([g.addCurveLoop(sides)])
    g.synchronize()

    def orientation():
        places = nodes_of(gmsh)
        t = np.array([[places[n][:2] for n in t] for t in elements_of(gmsh, 2, tag).tolist()])
        u, v = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
        ways = [
            {tuple(np.sign(np.subtract(places[b], places[a]))) for a, b in e.tolist()}
            for e in (elements_of(gmsh, 1, side) for side in sides)
        ]
        return set(np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])), ways

    gmsh.model.mesh.generate(2)
    before = orientation()
    adapter.remesh(tol=0.01, follow="x*x + y*y")
    assert orientation() == before


def test_a_view_can_be_followed(gmsh):
    square(gmsh)
    gmsh.model.mesh.generate(2)
    places = nodes_of(gmsh)
    x, y = np.array(list(places.values()))[:, :2].T
    view = gmsh.view.add("bump")
    values = np.maximum(np.abs(x - 0.5), np.abs(y - 0.5))
    gmsh.view.addHomogeneousModelData(
        view, 0, gmsh.model.getCurrent(), "NodeData", list(places), values
    )
    field = adapter.view_surface(view)
    made = adapter.remesh(tol=0.01, follow=view)
    assert equimesh.profile(made.points, made.triangles, field).bound <= 0.01 * (1 + 1e-9)
    corners = field.points[field.triangles]
    rows = np.concatenate([corners[..., :2], 0 * corners[..., :1]], axis=2)
    data = np.column_stack([rows.transpose(0, 2, 1).reshape(-1, 9), corners[..., 2]])
    listed = gmsh.view.add("list")
    gmsh.view.addListData(listed, "ST", len(data), data.ravel())
    assert adapter.profile(listed).bound <= 0.01 * (1 + 1e-9)
    for wrong in (gmsh.view.add("nothing"), 99):
        with pytest.raises(InputError, match=r"[Vv]iew"):
            adapter.view_surface(wrong)


def test_what_cannot_stay_consistent_is_refused_and_left_alone(gmsh):
    gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    gmsh.model.occ.addRectangle(1, 0, 0, 1, 1)
    gmsh.model.occ.fragment([(2, 1)], [(2, 2)])
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(2)
    before = fingerprint(gmsh)
    for options, words in [
        ({"tag": 1, "follow": WAVE}, "shares its border with the mesh of surface 2"),
        ({"tag": 1}, "give follow="),
        ({"follow": WAVE}, "2 surfaces"),
        ({"tag": 7, "follow": WAVE}, "no surface 7"),
    ]:
        with pytest.raises(InputError, match=words):
            adapter.remesh(tol=0.01, **options)
        assert fingerprint(gmsh) == before
    gmsh.model.mesh.clear([(2, 2)])
    adapter.remesh(1, tol=0.01, follow=WAVE)
    gmsh.model.mesh.generate(2)  # the neighbour takes the new nodes of the common curve
    check_conforming(gmsh, 2, 1.0)
    used = [set(elements_of(gmsh, 2, tag).ravel().tolist()) for tag in (1, 2)]
    (common,) = set(gmsh.model.getAdjacencies(2, 1)[1]) & set(gmsh.model.getAdjacencies(2, 2)[1])
    assert used[0] & used[1] == set(nodes_of(gmsh, 1, common, border=True))


@pytest.mark.parametrize("kind", ["sphere", "tilted", "embedded"])
def test_other_surfaces_are_refused(kind, gmsh):
    if kind == "sphere":
        gmsh.model.occ.addSphere(0, 0, 0, 1)
    else:
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    if kind == "tilted":
        gmsh.model.occ.rotate([(2, 1)], 0, 0, 0, 1, 0, 0, 1)
    if kind == "embedded":
        gmsh.model.occ.addPoint(0.5, 0.5, 0, tag=50)
    gmsh.model.occ.synchronize()
    if kind == "embedded":
        gmsh.model.mesh.embed(0, [50], 2, 1)
    words = {"sphere": "of the kind", "tilted": "not parallel", "embedded": "embedded"}
    with pytest.raises(InputError, match=words[kind]):
        adapter.remesh(tol=0.01, follow=WAVE)


def test_a_session_must_be_open():
    for action in (adapter.to_field, adapter.remesh, lambda: adapter.profile("x")):
        with pytest.raises(InputError, match=r"gmsh\.initialize"):
            action()


# Metrics


@pytest.mark.parametrize(
    "surface, tol", [(SURFACE, 0.01), ("exp(5*x)*sin(5*sqrt(10)*y)", 0.5), ("x**3 + y**3/2", 3e-4)]
)
def test_bamg_follows_the_background_metric(surface, tol, gmsh):
    metric = equimesh.Metric.of(surface, tol, (0, 0, 1, 1))
    square(gmsh)
    field = adapter.to_background(metric)
    assert gmsh.model.mesh.field.getNumber(field, "ViewTag") in gmsh.view.getTags()
    gmsh.model.mesh.generate(2)
    made = adapter.to_field()
    edges = made.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    lengths = metric.lengths(*(made.points[edges[:, k], :2] for k in range(2)))
    assert np.mean((lengths >= 0.5**0.5) & (lengths <= 2.0**0.5)) >= 0.95
    assert len(made.triangles) == pytest.approx(metric.unit_triangles((0, 0, 1, 1)), rel=0.1)


def test_the_background_may_be_the_mesh_of_a_result(gmsh):
    box = (0, 0, 1, 1)
    metric = equimesh.Metric.of(SURFACE, 0.01, box)
    square(gmsh, z=3.0)
    adapter.to_background(metric, mesh=equimesh.remesh(SURFACE, tol=0.01, domain=box))
    gmsh.model.mesh.generate(2)
    assert len(elements_of(gmsh, 2, 1)) == pytest.approx(metric.unit_triangles(box), rel=0.1)


def test_a_plane_surface_is_made_unit_in_a_metric(gmsh):
    gmsh.model.occ.addDisk(0.5, 0.5, 0, 0.4, 0.4)
    gmsh.model.occ.synchronize()
    metric = equimesh.Metric.of(SURFACE, 0.01, (0, 0, 1, 1))
    made = adapter.remesh(follow=metric, target=300)
    assert 280 <= len(elements_of(gmsh, 2, 1)) == len(made.triangles) <= 300
    assert made.profile.share >= 0.95
    places = np.array(list(nodes_of(gmsh, 1, 1, border=True).values()))
    np.testing.assert_allclose(np.hypot(*(places[:, :2] - 0.5).T), 0.4, rtol=1e-12)
    with pytest.raises(InputError, match="no metric"):
        adapter.to_background("x*x")


# Without Gmsh


def test_without_gmsh_files_are_of_format_22_and_models_name_the_extra(
    result, monkeypatch, tmp_path
):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    equimesh_adapters.save(tmp_path / "a.msh", result)
    assert (tmp_path / "a.msh").read_text().startswith("$MeshFormat\n2.2 0 8")
    points, triangles = equimesh_adapters.load_mesh(tmp_path / "a.msh")
    np.testing.assert_array_equal(points[triangles], result.points[result.triangles])
    for action in (
        adapter.to_field,
        lambda: adapter.from_result(result),
    ):
        with pytest.raises(InputError, match=r"pip install 'equimesh\[gmsh\]'"):
            action()
