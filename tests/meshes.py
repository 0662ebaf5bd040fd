"""Random meshes that several test files change, and what a mesh has to be."""

import itertools
import math

import numpy as np
import pytest
import shapely

from equimesh.domain import sides_of
from equimesh.fields.dispatch import edge_error, inner_error, value
from equimesh.fields.function import Function
from equimesh.fields.kernel import RASTER, KernelField
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.mesh import FIXED, FREE, GONE, SLIDES, build
from equimesh.optimise.topology import positive, star
from equimesh.triangulation import constrained_delaunay

TOL = 0.02
HOLED = shapely.Polygon(
    [(-1, -1), (1, -1), (1, 1), (-1, 1)], [[(-0.4, -0.4), (-0.3, 0.4), (0.4, 0.4)]]
)
DOMAINS = {"square": shapely.box(-1, -1, 1, 1), "hole": HOLED}


def smooth(domain):
    """A function with regions of either signature, in the unit frame of the kernels."""
    return Function("sin(2*x)*cos(2*y)+x**2/2").kernel(domain, 1e-3)


def raster(domain):
    """Heights on a grid that the domain, shifted onto it, lies in."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 13), np.linspace(-1.2, 1.2, 13))
    return KernelField(RASTER, frame=np.zeros(2), grid=np.sin(2 * x) * np.cos(2 * y) + x**2 / 2)


def make(domain, seed, field, scale=1.0, shift=0.0, inner=25):
    """A random mesh of a domain on a field, with vertices that slide along its sides."""
    rng = np.random.default_rng(seed)
    sides = sides_of(domain)
    n = len(sides.corners)
    points, kind, side, edges = [sides.corners], [FIXED] * n, list(range(n)), []
    count = n
    for i in range(n):
        a, b = sides.corners[i], sides.corners[sides.following[i]]
        s = np.sort(rng.uniform(0.1, 0.9, rng.integers(0, 4)))
        s = s[np.diff(s, prepend=0.0) > 0.05]
        chain = [i, *range(count, count + len(s)), sides.following[i]]
        edges += list(itertools.pairwise(chain))
        points.append(a + s[:, None] * (b - a))
        kind += [SLIDES] * len(s)
        side += [i] * len(s)
        count += len(s)
    xy = rng.uniform(-0.95, 0.95, (inner, 2))
    xy = xy[shapely.contains_xy(domain.buffer(-0.02), *xy.T)]
    points.append(xy)
    kind += [FREE] * len(xy)
    side += [0] * len(xy)
    plane = np.vstack(points)
    triangles = constrained_delaunay(plane, np.array(edges))
    plane = scale * plane + shift
    z = np.array([value(field, *p) for p in plane])
    segments = scale * np.hstack([sides.corners, sides.corners[sides.following]]) + shift
    mesh = build(
        np.column_stack([plane, z]), triangles, np.array(kind, np.int8), np.array(side), segments
    )
    evaluate_all(field, mesh, TOL)
    return mesh


def live(mesh):
    """Everything that means something in a mesh, slot by slot, scratch and spare slots left out."""
    t = np.flatnonzero(mesh.tv[:, 0] >= 0)
    v = np.flatnonzero(mesh.kind != GONE)
    found = {"t": t, "v": v}
    for name in ("tv", "tn", "wall", "ee", "ep", "ie", "ix", "iy"):
        found[name] = getattr(mesh, name)[t].copy()
    for name in ("x", "y", "z", "kind", "side", "v2t"):
        found[name] = getattr(mesh, name)[v].copy()
    return found


def assert_same(first, second):
    for name, array in first.items():
        assert np.array_equal(array, second[name]), name


def assert_mesh(mesh, domain, scale, field):
    """Adjacency, orientation, cover, stars, spare slots, and the errors that it keeps."""
    t = np.flatnonzero(mesh.tv[:, 0] >= 0)
    tv, tn = mesh.tv, mesh.tn
    seen = {}
    for s in t:
        a, b, c = tv[s]
        assert positive(mesh.x[a], mesh.y[a], mesh.x[b], mesh.y[b], mesh.x[c], mesh.y[c])
        for k in range(3):
            key = (int(tv[s, k]), int(tv[s, (k + 1) % 3]))
            assert key not in seen
            seen[key] = (s, k)
    for (a, b), (s, k) in seen.items():
        twin = seen.get((b, a))
        assert tn[s, k] == (-1 if twin is None else twin[0])
        if twin is not None:
            u, j = twin
            assert mesh.wall[s, k] == mesh.wall[u, j]
            assert mesh.ee[s, k] == mesh.ee[u, j]
            assert mesh.ep[s, k] == pytest.approx(1 - mesh.ep[u, j], abs=1e-15)
        p, q = ((mesh.x[v], mesh.y[v], mesh.z[v]) for v in (a, b))
        forth, back = (edge_error(field, *m, *n, 1e3 * TOL)[0] / TOL for m, n in ((p, q), (q, p)))
        # The two ways along an edge differ a little; the one that was walked is kept.
        near = 0.02 * max(abs(forth), abs(back)) + 1e-9
        assert min(abs(mesh.ee[s, k] - forth), abs(mesh.ee[s, k] - back)) <= near
    for s in t:
        corners = [w for v in tv[s] for w in (mesh.x[v], mesh.y[v], mesh.z[v])]
        found = [inner_error(field, *np.roll(corners, 3 * k), 1e3 * TOL)[0] / TOL for k in range(3)]
        near = 0.02 * max(map(abs, found)) + 1e-9
        assert min(abs(mesh.ie[s] - e) for e in found) <= near
    vertices = np.flatnonzero(mesh.kind != GONE)
    assert set(np.unique(tv[t])) == set(vertices)
    for v in vertices:
        assert mesh.tv[mesh.v2t[v]].tolist().count(v) == 1
        n, closed = star(mesh, v)
        assert sorted(mesh.ring[1, :n]) == sorted(s for s in t if v in tv[s])
        assert closed == (mesh.kind[v] == FREE)
        x, y = mesh.x[v], mesh.y[v]
        if mesh.kind[v] == SLIDES:
            ax, ay, bx, by = mesh.sides[mesh.side[v]]
            assert abs((bx - ax) * (y - ay) - (by - ay) * (x - ax)) <= 1e-12 * scale**2
        assert mesh.z[v] == pytest.approx(value(field, x, y), abs=1e-12)
    edges = len({tuple(sorted(e)) for e in seen})
    holes = len(domain.interiors)
    assert len(vertices) - edges + len(t) == 1 - holes
    p = np.stack([mesh.x, mesh.y], 1)
    u, w = p[tv[t, 1]] - p[tv[t, 0]], p[tv[t, 2]] - p[tv[t, 0]]
    area = math.fsum(0.5 * (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]))
    assert area == pytest.approx(domain.area * scale**2, rel=1e-12)
    spare_t, spare_v = (
        stack[: mesh.count[k]].tolist() for stack, k in ((mesh.spare_t, 2), (mesh.spare_v, 3))
    )
    assert len(set(spare_t)) == len(spare_t)
    assert len(set(spare_v)) == len(spare_v)
    assert sorted(spare_t + t.tolist()) == list(range(mesh.count[0]))
    assert sorted(spare_v + vertices.tolist()) == list(range(mesh.count[1]))
