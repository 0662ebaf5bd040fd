"""Unit meshes in given metrics."""

import itertools
import math

import numpy as np
import pytest
import shapely

import equimesh
from equimesh import InputError, Metric, Status
from equimesh.frame import Frame
from equimesh.optimise.mesh import FIXED, FREE, build, compact
from equimesh.optimise.topology import begin, rollback
from equimesh.riemann.changes import collapse, split
from equimesh.riemann.energy import energy_of, move, try_flip
from equimesh.riemann.patches import fit_metric
from equimesh.riemann.profile import metric_profile
from equimesh.riemann.relax import set_energies

SQUARE = shapely.box(0, 0, 1, 1)
HOLED = shapely.Polygon(
    [(0, 0), (1, 0.05), (1.1, 0.6), (0.6, 1.0), (0.1, 0.8)],
    [[(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)]],
)


def along(angle, size, across):
    c, s = np.cos(angle), np.sin(angle)
    a, b = np.broadcast_to(size, c.shape) ** -2.0, np.broadcast_to(across, c.shape) ** -2.0
    rows = (
        np.stack([a * c * c + b * s * s, (a - b) * c * s], -1),
        np.stack([(a - b) * c * s, a * s * s + b * c * c], -1),
    )
    return np.stack(rows, -2)


def sphere(x, y):
    r2 = 4.0 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)
    return (4.0 / (1.0 + r2) ** 2)[:, None, None] * np.eye(2)


METRICS = {
    "constant 1:30": lambda x, y: along(0 * x, 1.0, 1.0 / 30.0),
    "oblique 1:10": lambda x, y: along(0 * x + 0.6, 1.0, 0.1),
    "harmonic": lambda x, y: np.exp(3 * x * y + 2 * x * x - 2 * y * y)[:, None, None] * np.eye(2),
    "sphere": sphere,
    "layer 1:1000": lambda x, y: along(0 * x, 1.0, 1e-3 + 0.3 * np.abs(y)),
    "sizes 1:300": lambda x, y: (
        (1e-3 + 0.3 * np.hypot(x - 0.3, y - 0.25))[:, None, None] ** -2.0 * np.eye(2)
    ),
    "swirl": lambda x, y: along(4 * np.hypot(x - 0.5, y - 0.5) + y, 0.2 + 0.1 * x, 1.0),
}


def measured(tensor, result):
    """Share of edges in [1/sqrt 2, sqrt 2] and mean quality, apart from the package."""
    p, t = result.points[:, :2], result.triangles
    ends = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    e = np.unique(ends, axis=0)
    d = p[e[:, 1]] - p[e[:, 0]]
    s = (np.arange(20) + 0.5) / 20
    q = (p[e[:, 0], None] + s[None, :, None] * d[:, None]).reshape(-1, 2)
    m = tensor(*q.T).reshape(len(e), 20, 2, 2)
    length = np.sqrt(np.einsum("ni,nqij,nj->nq", d, m, d)).mean(1)
    corner = p[t]
    m = tensor(*corner.mean(1).T)
    side = corner - np.roll(corner, 1, axis=1)
    squares = np.einsum("tki,tij,tkj->t", side, m, side)
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    quality = 4 * 3**0.5 * area * np.sqrt(np.linalg.det(m)) / squares
    return ((length > 0.5**0.5) & (length < 2**0.5)).mean(), quality.mean()


def assert_covers(result, domain):
    """A conforming, counter-clockwise triangulation of the domain with its tagged boundary."""
    p, t = result.points[:, :2], result.triangles
    u, v = p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(domain.area, rel=1e-9)
    assert len(np.unique(t)) == len(p)
    directed = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)
    pairs = {tuple(e) for e in directed.tolist()}
    border = {e for e in pairs if e[::-1] not in pairs}
    assert border == {tuple(e) for e in result.boundary.edges.tolist()}
    corners = {tuple(c) for c in shapely.get_coordinates(domain).tolist()}
    assert corners <= {tuple(c) for c in p.tolist()}
    assert (result.points[:, 2] == 0.0).all()


@pytest.mark.parametrize("domain", [SQUARE, HOLED], ids=["square", "holed"])
@pytest.mark.parametrize("name", METRICS)
def test_edges_are_unit_and_triangles_equilateral_and_as_many_as_the_area_asks(name, domain):
    metric = Metric(METRICS[name]).normalise(domain, 1500)
    result = equimesh.remesh(metric, domain=domain)
    assert_covers(result, domain)
    share, quality = measured(metric, result)
    assert share >= 0.98
    assert quality >= 0.95
    assert len(result.triangles) == pytest.approx(1500, rel=0.04)
    assert result.lower_bound == pytest.approx(1500, rel=1e-4)
    assert result.status is Status.UNIT
    assert result.status.ok
    assert result.profile.share == pytest.approx(share, abs=0.004)
    assert result.profile.quality == pytest.approx(quality, abs=0.004)


def test_a_lattice_that_fits_the_domain_comes_back_whole():
    height = math.sqrt(0.75)
    domain = shapely.Polygon([(0, 0), (12, 0), (17, 10 * height), (5, 10 * height)])
    result = equimesh.remesh(Metric(np.eye(2)), domain=domain)
    assert len(result.triangles) == 240
    np.testing.assert_allclose(result.profile.lengths, 1.0, atol=1e-3)
    np.testing.assert_allclose(result.profile.qualities, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    "scale, shift, angle", [(1e-6, 0.0, 0.0), (3.0, 5e6, 0.5), (1e4, -40.0, 2.1)]
)
def test_rotation_scale_and_place_do_not_matter(scale, shift, angle):
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    base = Metric(METRICS["swirl"]).normalise(SQUARE, 1500)

    def tensor(x, y):
        u = (np.stack([x, y], 1) - shift) @ turn / scale
        return turn @ base(*u.T) @ turn.T / scale**2

    corners = scale * shapely.get_coordinates(SQUARE) @ turn.T + shift
    moved = equimesh.remesh(Metric(tensor), domain=shapely.Polygon(corners))
    still = equimesh.remesh(base, domain=SQUARE)
    assert len(moved.triangles) == pytest.approx(len(still.triangles), rel=0.03)
    assert moved.profile.share == pytest.approx(still.profile.share, abs=0.01)
    assert moved.profile.quality == pytest.approx(still.profile.quality, abs=0.01)


def test_the_same_call_gives_the_same_bytes():
    metric = Metric(METRICS["swirl"]).normalise(SQUARE, 600)
    first, second = (equimesh.remesh(metric, domain=SQUARE) for _ in range(2))
    assert first.points.tobytes() == second.points.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()


def test_tol_scales_like_that_of_an_error():
    metric = Metric(sphere).normalise(SQUARE, 2000)
    result = equimesh.remesh(metric, tol=4.0, domain=SQUARE)
    assert result.tol == 4.0
    assert result.lower_bound == pytest.approx(500, rel=1e-4)
    assert len(result.triangles) == pytest.approx(500, rel=0.04)
    in_own = metric.lengths(*result.points[result.triangles[:, :2], :2].transpose(1, 0, 2))
    assert np.median(in_own) == pytest.approx(2.0, rel=0.05)


def test_a_target_is_met():
    result = equimesh.remesh(Metric(METRICS["layer 1:1000"]), target=800, domain=SQUARE)
    assert 0.97 * 800 <= len(result.triangles) <= 800


def test_efforts():
    metric = Metric(METRICS["swirl"]).normalise(SQUARE, 800)
    fast, best = (equimesh.remesh(metric, domain=SQUARE, effort=e) for e in ("fast", "best"))
    assert best.profile.quality >= fast.profile.quality - 0.003
    assert best.profile.share >= 0.98


def test_neighbours_that_share_a_side_have_the_same_nodes_on_it():
    metric = Metric(METRICS["swirl"]).normalise(SQUARE, 1000)
    left = equimesh.remesh(metric, domain=(0, 0, 0.5, 1))
    right = equimesh.remesh(
        metric, domain=shapely.box(0.5, 0, 1, 1) | shapely.box(0.9, 0.2, 1.3, 0.4)
    )
    on = [np.unique(r.points[r.points[:, 0] == 0.5], axis=0) for r in (left, right)]
    assert len(on[0]) > 10
    np.testing.assert_array_equal(*on)


def test_boundary_curves_keep_their_names():
    result = equimesh.remesh(Metric.isotropic(0.1), domain=(0, 0, 2, 1))
    assert result.boundary.names == ("bottom", "right", "top", "left")
    bottom = result.points[result.boundary.edges_of("bottom")]
    assert (bottom[..., 1] == 0.0).all()
    np.testing.assert_allclose(bottom[:, 1, 0] - bottom[:, 0, 0], 0.1)


def test_parts_that_touch_in_a_corner_and_rings():
    domain = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(1, 1, 2, 2)])
    result = equimesh.remesh(Metric.isotropic(0.09), domain=domain)
    assert_covers(result, domain)
    ring = shapely.Point(0, 0).buffer(1.0, quad_segs=16) - shapely.Point(0, 0).buffer(
        0.3, quad_segs=8
    )
    result = equimesh.remesh(Metric.isotropic(0.05), domain=ring)
    assert_covers(result, ring)
    assert result.profile.share >= 0.98


def test_a_jump_of_the_metric():
    metric = Metric.isotropic(lambda x, y: np.where(x + 0.3 * y < 0.6, 0.02, 0.08))
    result = equimesh.remesh(metric, domain=SQUARE)
    assert_covers(result, SQUARE)
    assert result.profile.share >= 0.9
    assert result.profile.quality >= 0.9


def test_a_metric_on_a_background_mesh():
    from scipy.spatial import Delaunay

    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 33), np.linspace(0, 1, 33)))
    p = np.stack([x, y], 1)
    smooth = Metric(METRICS["swirl"]).normalise(SQUARE, 1000)
    metric = Metric.on_mesh(p, Delaunay(p).simplices, smooth(x, y))
    result = equimesh.remesh(metric, domain=SQUARE)
    share, quality = measured(smooth, result)
    assert share >= 0.98
    assert quality >= 0.95
    assert len(result.triangles) == pytest.approx(1000, rel=0.04)


def test_a_metric_that_is_undefined_outside_the_domain():
    metric = Metric(
        lambda x, y: np.where(x * x + y * y <= 1.0 + 1e-9, 100.0, np.nan)[:, None, None] * np.eye(2)
    )
    disc = shapely.Point(0, 0).buffer(1.0, quad_segs=16)
    result = equimesh.remesh(metric, domain=disc)
    assert_covers(result, disc)
    assert result.profile.share >= 0.98


def test_a_domain_thinner_than_its_edges_is_meshed_and_said_to_be_no_unit_mesh():
    metric = Metric(lambda x, y: along(0 * x + 0.6, 1.0, 1e-3)).normalise(SQUARE, 1000)
    result = equimesh.remesh(metric, domain=SQUARE)
    assert_covers(result, SQUARE)
    assert result.status is Status.NOT_UNIT
    assert not result.status.ok
    assert "gradation" in result.status.value


def test_few_and_single_triangles():
    for size in (10.0, 1.0, 0.6):
        result = equimesh.remesh(Metric.isotropic(size), domain=SQUARE)
        assert_covers(result, SQUARE)


def test_the_profile():
    result = equimesh.remesh(Metric.isotropic(0.1), domain=SQUARE)
    profile = result.profile
    np.testing.assert_array_equal(profile.errors, 1.0 - profile.qualities)
    assert profile.quantile(0.0) == profile.qualities.min()
    assert profile.max == pytest.approx(1.0 - profile.qualities.min())
    assert len(profile.lengths) == len(result.points) + len(result.triangles) - 1  # Euler
    axes = profile.plot()
    assert sum(patch.get_height() for patch in axes.patches) == len(profile.lengths)
    one = metric_profile(
        Metric(np.eye(2)), np.array([[0, 0], [1, 0], [0.5, math.sqrt(0.75)]]), np.array([[0, 1, 2]])
    )
    np.testing.assert_allclose([one.quality, one.share, *one.lengths], 1.0)


def test_progress_and_cancelling():
    seen = []
    equimesh.remesh(Metric.isotropic(0.2), domain=SQUARE, progress=lambda *a: seen.append(a))
    assert [name for name, _ in itertools.groupby(seen, key=lambda a: a[0])] == [
        "field", "seed", "optimise", "certify",
    ]  # fmt: skip
    with pytest.raises(equimesh.Cancelled):
        equimesh.remesh(Metric.isotropic(0.2), domain=SQUARE, progress=lambda s, f: s != "optimise")


@pytest.mark.parametrize(
    "options, words",
    [
        ({}, "no domain of its own"),
        ({"domain": SQUARE, "tol": -1.0}, "positive number"),
        ({"domain": SQUARE, "tol": "1%"}, "positive number"),
        ({"domain": SQUARE, "tol": 1.0, "target": 10}, "one of the two"),
        ({"domain": SQUARE, "target": 1}, "2 or more"),
        ({"domain": SQUARE, "effort": "huge"}, "unknown"),
        ({"domain": SQUARE, "fit": "best"}, "neither fit="),
        ({"domain": SQUARE, "constraints": [[(0, 0), (1, 1)]]}, "neither fit="),
        ({"domain": SQUARE, "tol": 1e-12}, "asks for about"),
        ({"domain": (0, 0, 0, 1)}, "empty"),
    ],
)
def test_options_that_make_no_sense(options, words):
    with pytest.raises(InputError, match=words):
        equimesh.remesh(Metric.isotropic(0.1), **options)


@pytest.mark.parametrize("value", [np.nan, 0.0, -1.0])
def test_a_metric_that_fails_inside_the_domain(value):
    def tensor(x, y):
        bad = np.hypot(x - 0.5, y - 0.5) < 0.2
        return np.where(bad, value, 100.0)[:, None, None] * np.eye(2)

    with pytest.raises(InputError, match=r"The metric is not \w+( \w+)? at"):
        equimesh.remesh(Metric(tensor), domain=SQUARE)


def patches_of(metric):
    return fit_metric(metric, shapely.box(-2, -2, 3, 3), Frame(np.zeros(2), np.eye(2)))


def star():
    """Seven vertices, six equilateral triangles, unit in the Euclidean metric."""
    angle = np.arange(6) * math.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    points = np.vstack([[[0.0, 0.0, 0.0]], ring])
    triangles = np.array([[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)])
    kind = np.array([FREE] + 6 * [FIXED], np.int8)
    return build(points, triangles, kind, np.zeros(7, np.int64), np.zeros((1, 4)))


def test_the_energy_is_zero_for_the_unit_triangle_and_the_same_for_sizes_h_and_1_over_h():
    patches = patches_of(Metric(np.eye(2)))
    mesh = star()
    assert energy_of(patches, mesh, 0, 1, 2) == pytest.approx(0.0, abs=1e-9)
    assert energy_of(patches, mesh, 0, 2, 1) >= 1e29
    found = []
    for h in (1.7, 1 / 1.7):
        other = patches_of(Metric(np.eye(2) * h**2))
        found.append(energy_of(other, mesh, 0, 1, 2))
    assert found[0] == pytest.approx(found[1])
    assert found[0] == pytest.approx(2 * 1.7**2 + 2 / 1.7**2 - 4)


def test_a_vertex_moves_to_the_centre_of_its_star():
    patches = patches_of(Metric(np.eye(2)))
    mesh = star()
    mesh.x[0], mesh.y[0] = 0.35, -0.2
    set_energies(patches, mesh)
    before = mesh.ie[:6].sum()
    gains = [move(patches, mesh, 0) for _ in range(6)]
    np.testing.assert_allclose([mesh.x[0], mesh.y[0]], 0.0, atol=1e-6)
    assert sum(gains) == pytest.approx(before, abs=1e-6)
    assert move(patches, mesh, 1) == 0.0  # fixed


def test_splits_collapses_and_flips_keep_the_mesh_whole_and_can_be_undone():
    patches = patches_of(Metric(np.eye(2)))
    mesh = star()
    set_energies(patches, mesh)
    old = [a.copy() for a in compact(mesh)]
    begin(mesh)
    v = split(patches, mesh, 0, 0)
    assert v >= 0
    points, triangles, _, _ = compact(mesh)
    assert (len(points), len(triangles)) == (8, 8)
    assert shapely.area(shapely.polygons(points[triangles, :2])).sum() == pytest.approx(
        1.5 * 3**0.5
    )
    assert collapse(patches, mesh, v, 0)
    points, triangles, _, _ = compact(mesh)
    assert {tuple(sorted(t)) for t in triangles.tolist()} == {
        tuple(sorted(t)) for t in old[1].tolist()
    }
    rollback(mesh)
    for a, b in zip(old, compact(mesh), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not collapse(patches, mesh, 1, 0)  # a boundary vertex
    assert not try_flip(patches, mesh, 0, 0)  # the best already
