"""Functions with kinks: where they are, errors of what crosses them, and meshes along them."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

import equimesh
from equimesh.errors import InputError
from equimesh.expression import parse
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.fields.kink_kernels import edge_error, inner_error, sharpest
from equimesh.fields.patch_kernels import derivatives2, derivatives3
from equimesh.fields.patches import fit_patches
from equimesh.metric import AREA_CONVEX

SQUARE = shapely.box(-1, -1, 1, 1)
UNIT = (0.0, 0.0, 1.0, 1.0)
SEEDS = st.integers(0, 2**32 - 1)
SMOOTH = [
    ("exp(5*x)*sin(5*y)", UNIT, 0.05),
    ("1/((x-1.1)**2+(y-0.4)**2)", UNIT, 0.01),
    ("exp(2*x+y)+(x-2*y)**2", UNIT, 1e-3),
    (
        "0.75*exp(-((9*x-2)**2+(9*y-2)**2)/4)+0.75*exp(-(9*x+1)**2/49-(9*y+1)/10)"
        "+0.5*exp(-((9*x-7)**2+(9*y-3)**2)/4)-0.2*exp(-(9*x-4)**2-(9*y-7)**2)",
        UNIT,
        1e-3,
    ),
    ("tanh(20*(x-y**2))", UNIT, 2e-3),
    ("tanh(300*(x-y**2))", UNIT, 2e-3),
    ("exp(-400*((x-0.3)**2+(y-0.6)**2))", UNIT, 1e-2),
    ("x**5*y-sin(40*x*y)", UNIT, 0.1),
]


def circle(x, y):
    return np.abs(x * x + y * y - 0.5)


def patched(f, tol=1e-6, domain=SQUARE):
    p = fit_patches(f, domain, tol)
    return p, KernelField(PATCHES, frame=p.frame, child=p.child, coef=p.coef, kinks=p.kinks)


CIRCLE = patched(circle)[1]


def kinked_cells(patches):
    """(k, 3): corner and side of every leaf with a kink."""
    cells = []

    def visit(node, x, y, side):
        for q in range(4):
            u, v = x + 0.5 * side * (q % 2), y + 0.5 * side * (q // 2)
            below = patches.child[node, q]
            assert bool(patches.kinks[node] >> q & 1) == has_kink(patches, below)
            if below > 0:
                visit(below, u, v, 0.5 * side)
            elif -below - 1 >= patches.smooth:
                cells.append((u, v, 0.5 * side))

    visit(0, *patches.origin, patches.side)
    return np.array(cells)


def has_kink(patches, below):
    return -below - 1 >= patches.smooth if below < 0 else patches.kinks[below] > 0


@pytest.mark.parametrize("text, box, tol", SMOOTH)
@pytest.mark.parametrize("share", [1e-5, 1e-4, 1e-3])
def test_smooth_functions_have_no_kinks(text, box, tol, share):
    patches = fit_patches(parse(text).value, shapely.box(*box), share * tol)
    assert patches.smooth == len(patches.coef)
    assert not patches.kinks.any()


def test_kinks_lie_where_they_are_and_all_along():
    patches, _ = patched(circle)
    cells = kinked_cells(patches)
    assert len(cells) == len(patches.coef) - patches.smooth
    middle = cells[:, :2] + 0.5 * cells[:, 2:]
    radius = np.hypot(*middle.T)
    assert (np.abs(radius - math.sqrt(0.5)) <= 1.5 * cells[:, 2]).all()
    angles = np.sort(np.arctan2(middle[:, 1], middle[:, 0]))
    gaps = np.diff(angles)
    wide = gaps > 4.0 * cells[:, 2].max() / math.sqrt(0.5)
    # Where it cuts no more than a corner from a cell, outside all samples, it is not seen.
    assert gaps[wide].sum() <= 0.01 * 2.0 * math.pi


def test_second_derivatives_beside_a_kink_say_nothing_and_elsewhere_all():
    patches, field = patched(circle)
    given = (field.frame, field.child, field.coef)
    u, v, side = kinked_cells(patches)[5]
    assert derivatives2(*given, u + 0.5 * side, v + 0.5 * side)[3:] == (0.0, 0.0, 0.0)
    assert derivatives3(*given, u + 0.5 * side, v + 0.5 * side) == (0.0,) * 7
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 500))
    for px, py in zip(x, y, strict=True):
        r2 = px * px + py * py
        if abs(r2 - 0.5) > 0.02:
            exact = math.copysign(2.0, r2 - 0.5)
            assert derivatives2(*given, px, py)[3:] == pytest.approx((exact, 0, exact), abs=0.02)


@given(SEEDS)
@example(0)
def test_an_edge_across_kinks_has_the_error_that_many_samples_find(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-1, 1, (2, 2))
    za, zb = circle(*a), circle(*b)
    e, s = edge_error(CIRCLE, *a, za, *b, zb, 1e9)
    t = np.linspace(0, 1, 20_001)
    errors = circle(a[0] + t * (b - a)[0], a[1] + t * (b - a)[1]) - (za + t * (zb - za))
    assert abs(e) == pytest.approx(np.abs(errors).max(), rel=0.02, abs=1e-3)
    assert abs(e) == pytest.approx(abs(np.interp(s, t, errors)), abs=2e-3)


@given(SEEDS)
@example(0)
def test_a_triangle_across_kinks_has_nearly_the_error_that_many_samples_find(seed):
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, 1, (3, 2))
    area = np.linalg.det(p[1:] - p[0])
    if abs(area) < 0.01:
        return
    z = circle(*p.T)
    e, x, y = inner_error(CIRCLE, *np.column_stack([p, z]).ravel(), 1e9)
    edges = [
        edge_error(CIRCLE, *p[i], z[i], *p[j], z[j], 1e9)[0] for i, j in ((0, 1), (1, 2), (2, 0))
    ]
    u, v = np.meshgrid(np.linspace(0, 1, 301), np.linspace(0, 1, 301))
    u, v = u[u + v <= 1], v[u + v <= 1]
    weights = np.stack([1 - u - v, u, v])
    errors = np.abs(circle(*(p.T @ weights)) - z @ weights)
    found = max(abs(e), *map(abs, edges))
    assert found >= 0.9 * errors.max()
    assert found <= 1.02 * errors.max() + 1e-3
    # Where it says that the error is, there it is.
    at = np.linalg.solve(np.vstack([p.T, np.ones(3)]), [x, y, 1.0])
    assert at.min() >= -1e-9
    assert abs(e) == pytest.approx(abs(circle(x, y) - z @ at), abs=2e-3) or e == 0.0


def test_the_sharpest_kink():
    jump, _, y = sharpest(patched(lambda x, y: np.abs(x - 0.3) + 3 * np.abs(y + 0.2 + 0 * x))[1])
    assert jump == pytest.approx(math.hypot(2.0, 6.0), rel=0.3)
    assert y == pytest.approx(-0.2, abs=1e-3)
    assert sharpest(patched(lambda x, y: np.sin(x * y))[1])[0] == 0.0


KINKED = {
    "circle": (circle, UNIT, 1.0),
    "two bowls": (
        lambda x, y: np.minimum((x - 0.2) ** 2 + (y - 0.3) ** 2, (x - 0.8) ** 2 + (y - 0.6) ** 2),
        UNIT,
        1.0,
    ),
    "folded waves": (
        lambda x, y: np.sin(6 * np.abs(x - 0.05 * y)) + y * y,
        (-1.0, -1.0, 1.0, 1.0),
        None,
    ),
    "waves": (lambda x, y: np.maximum(np.sin(5 * x), np.cos(4 * y)), UNIT, 0.0),
    "clipped": (lambda x, y: np.clip(np.sin(6 * x) * np.cos(5 * y), -0.5, 0.5), UNIT, None),
}


def most_found(f, result, n=24):
    """The largest error at n (n + 1) / 2 points of every triangle."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    weights = np.stack([1 - u - v, u, v])[:, u + v <= 1]
    corners = result.points[result.triangles]
    x, y, z = (corners[..., k] @ weights for k in range(3))
    return np.abs(f(x, y) - z).max()


@pytest.mark.parametrize("name", KINKED)
@pytest.mark.parametrize("tol", ["1%", "0.1%"])
def test_kinks_are_meshed_and_certified(name, tol):
    f, box, root = KINKED[name]
    result = equimesh.remesh(f, tol, box, effort="fast")
    assert result.status.ok
    assert most_found(f, result) <= 1.001 * result.tol
    if root is not None:  # of det(H / 2), beside the kinks, which have no area
        exact = root / (AREA_CONVEX * result.tol)
        assert result.lower_bound == pytest.approx(exact, rel=0.01, abs=0.2)
    if root:  # vertices lie along kinks, which take few triangles
        assert len(result.triangles) <= result.lower_bound + 6.0 * math.sqrt(result.lower_bound)


@pytest.mark.parametrize("tol", ["1%", "0.1%", "0.01%"])
def test_a_roof_is_its_faces(tol):
    # The largest of four planes: eight triangles at most whatever the tolerance.
    def roof(x, y):
        return -np.maximum(np.abs(x - 0.1), 0.7 * np.abs(y + 0.05))

    result = equimesh.remesh(roof, tol, (-1.0, -1.0, 1.0, 1.0))
    assert result.status.ok
    assert len(result.triangles) <= 14
    assert most_found(roof, result, 60) <= result.tol


@pytest.mark.parametrize("options", [{"fit": "best"}, {"min_angle": 15}, {"target": 300}])
def test_kinks_with_options(options):
    tol = None if "target" in options else 3e-3
    result = equimesh.remesh(circle, tol, UNIT, effort="fast", **options)
    assert result.status.ok
    assert most_found(circle, result) <= 1.001 * result.tol


def test_many_lattices_of_few_triangles():
    # More turns of the lattice than seeds for it.
    result = equimesh.remesh(lambda x, y: np.abs(x - y), 1e-2, UNIT, effort="best")
    assert result.status.ok
    assert len(result.triangles) == 2


def test_a_gradient_that_jumps_is_refused_where_it_does():
    with pytest.raises(InputError, match=r"kink near .* jumps by about"):
        equimesh.remesh(circle, 0.1, UNIT, norm="gradient")
