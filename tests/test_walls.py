"""Edges that must stay: whatever is done to a mesh they cover the same line."""

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from equimesh.fields.dispatch import value
from equimesh.fields.function import Function
from equimesh.optimise.energy import edge_of, evaluate_all, inner_of, penalty
from equimesh.optimise.flips import try_flip
from equimesh.optimise.insertion import split_edge, split_inside
from equimesh.optimise.mesh import FIXED, FREE, GONE, SLIDES, build
from equimesh.optimise.moves import move_vertex
from equimesh.optimise.removal import remove_vertex
from equimesh.optimise.topology import ample, begin, commit, positive, rollback, star
from equimesh.triangulation import constrained_delaunay

TOL = 0.02
SQUARE = shapely.box(-1, -1, 1, 1)
# A line with a branch; all three pieces are walls.
BRANCHES = np.array([[-0.7, -0.5], [0.1, 0.05], [0.8, 0.6], [-0.2, 0.75]])
PIECES = np.array([[0, 1], [1, 2], [1, 3]])
ARRAYS = (
    ("t", ("tv", "tn", "wall", "ee", "ep", "ie", "ix", "iy")),
    ("v", ("x", "y", "z", "kind", "side", "v2t")),
)


def field():
    return Function("sin(2*x)*cos(2*y)+x**2/2").kernel(SQUARE, 1e-3)


def make(seed):
    """A random mesh of the square with sliding vertices on the walls."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    points, kind, side, walls = [corners, BRANCHES], [FIXED] * 8, [0] * 8, []
    count = 8
    for number, (a, b) in enumerate(PIECES):
        share = np.sort(rng.uniform(0.1, 0.9, 4))
        share = share[np.diff(share, prepend=0.0) > 0.05]
        points.append(BRANCHES[a] + share[:, None] * (BRANCHES[b] - BRANCHES[a]))
        chain = [4 + a, *range(count, count + len(share)), 4 + b]
        walls += list(itertools.pairwise(chain))
        kind += [SLIDES] * len(share)
        side += [4 + number] * len(share)
        count += len(share)
    inner = rng.uniform(-0.95, 0.95, (40, 2))
    lines = shapely.union_all(shapely.linestrings(BRANCHES[PIECES]))
    inner = inner[shapely.distance(lines, shapely.points(inner)) > 0.03]
    plane = np.vstack([*points, inner])
    kind += [FREE] * len(inner)
    side += [0] * len(inner)
    ring = np.stack([np.arange(4), (np.arange(4) + 1) % 4], 1)
    triangles = constrained_delaunay(plane, ring, np.array(walls))
    segments = np.vstack(
        [np.hstack([corners, np.roll(corners, -1, axis=0)]), BRANCHES[PIECES].reshape(-1, 4)]
    )
    f = field()
    z = np.array([value(f, *p) for p in plane])
    mesh = build(
        np.column_stack([plane, z]), triangles, np.array(kind, np.int8), np.array(side),
        segments, np.array(walls),
    )  # fmt: skip
    evaluate_all(f, mesh, TOL)
    return f, mesh


def change(f, mesh, rng, number):
    """Random operations; how many vertices left a wall, and how many came onto one."""
    off = on = 0
    for _ in range(number):
        t = int(rng.choice(np.flatnonzero(mesh.tv[:, 0] >= 0)))
        v = int(rng.choice(np.flatnonzero(mesh.kind != GONE)))
        k, what = int(rng.integers(3)), int(rng.integers(5))
        if what == 0:
            try_flip(f, mesh, TOL, t, k)
        elif what == 1:
            move_vertex(f, mesh, TOL, v)
        elif what == 2:
            walled = mesh.kind[v] == SLIDES and mesh.side[v] >= 4
            off += walled and remove_vertex(f, mesh, TOL, v, 1e9) >= 0
        elif what == 3:
            x, y = rng.dirichlet([2, 2, 2]) @ np.stack([mesh.x, mesh.y], 1)[mesh.tv[t]]
            split_inside(f, mesh, TOL, t, x, y)
        else:
            made = split_edge(f, mesh, TOL, t, k, rng.uniform(0.2, 0.8))
            on += made >= 0 and mesh.kind[made] == SLIDES and mesh.side[made] >= 4
    return off, on


def assert_mesh(f, mesh):
    """Adjacency, orientation, kept errors, stars, and walls that cover the pieces once."""
    live = np.flatnonzero(mesh.tv[:, 0] >= 0)
    seen = {
        (int(mesh.tv[t, k]), int(mesh.tv[t, (k + 1) % 3])): (t, k) for t in live for k in range(3)
    }
    assert len(seen) == 3 * len(live)
    walls = []
    for (a, b), (t, k) in seen.items():
        twin = seen.get((b, a))
        assert mesh.tn[t, k] == (-1 if twin is None else twin[0])
        if twin is not None:
            assert mesh.wall[t, k] == mesh.wall[twin]
            assert mesh.ee[t, k] == mesh.ee[twin]
        e = [abs(edge_of(f, mesh, TOL, *ends)[0]) for ends in ((a, b), (b, a))]
        assert min(abs(abs(mesh.ee[t, k]) - np.array(e))) <= 0.02 * max(e) + 1e-9
        if mesh.wall[t, k] and a < b:
            walls.append((a, b))
    p = np.stack([mesh.x, mesh.y], 1)
    for t in live:
        assert positive(*p[mesh.tv[t]].ravel())
    for v in np.flatnonzero(mesh.kind != GONE):
        n, closed = star(mesh, v)
        assert sorted(mesh.ring[1, :n]) == sorted(t for t in live if v in mesh.tv[t])
        assert closed == (mesh.kind[v] == FREE or np.abs(p[v]).max() < 1.0)
    lines = shapely.linestrings(p[np.array(walls)])
    whole = shapely.linestrings(BRANCHES[PIECES])
    assert shapely.length(lines).sum() == pytest.approx(shapely.length(whole).sum(), rel=1e-12)
    apart = shapely.distance(shapely.union_all(whole), shapely.points(p[np.unique(walls)]))
    assert apart.max() <= 1e-14


SEEDS = st.integers(0, 2**32 - 1)


@given(seed=SEEDS)
@example(seed=0)
@settings(max_examples=15, deadline=None)
def test_walls_cover_their_lines_whatever_is_done(seed):
    f, mesh = make(seed)
    rng = np.random.default_rng(seed)
    assert_mesh(f, mesh)
    for _ in range(4):
        change(f, mesh, rng, 25)
        assert_mesh(f, mesh)


def test_vertices_come_and_go_on_walls():
    off = on = 0
    for seed in range(3):
        f, mesh = make(seed)
        found = change(f, mesh, np.random.default_rng(seed), 200)
        off, on = off + found[0], on + found[1]
    assert off >= 5
    assert on >= 5


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_rollback_restores_walls(seed):
    f, mesh = make(seed)
    rng = np.random.default_rng(seed)

    def content():
        slots = {
            "t": np.flatnonzero(mesh.tv[:, 0] >= 0),
            "v": np.flatnonzero(mesh.kind != GONE),
        }
        return [getattr(mesh, name)[slots[of]].copy() for of, names in ARRAYS for name in names]

    for keep in (False, True, False):
        before = content()
        begin(mesh)
        change(f, mesh, rng, 30)
        if keep:
            commit(mesh)
        else:
            rollback(mesh)
            assert all(map(np.array_equal, before, content()))
    assert_mesh(f, mesh)


def test_removal_from_a_wall_fills_both_parts_with_the_least_penalty():
    f = field()
    rng = np.random.default_rng(4)
    for _ in range(20):
        angle = 2 * math.pi * (np.arange(8) + rng.uniform(-0.2, 0.2, 8)) / 8
        ring = 0.7 * np.stack([np.cos(angle), np.sin(angle)], 1)
        start = int(rng.integers(8))
        end = (start + 3 + int(rng.integers(3))) % 8
        middle = ring[start] + rng.uniform(0.4, 0.6) * (ring[end] - ring[start])
        plane = np.vstack([ring, middle])
        z = np.array([value(f, *p) for p in plane])
        spokes = np.stack([np.full(8, 8), np.arange(8), (np.arange(8) + 1) % 8], 1)
        sides = np.vstack(
            [np.hstack([ring, np.roll(ring, -1, axis=0)]), np.hstack([ring[start], ring[end]])]
        )
        kind = np.array([FIXED] * 8 + [SLIDES], np.int8)
        side = np.array([0] * 8 + [8])
        walls = np.array([[8, start], [end, 8]])
        mesh = build(np.column_stack([plane, z]), spokes, kind, side, sides, walls)
        evaluate_all(f, mesh, TOL)
        found = remove_vertex(f, mesh, TOL, 8, 1e9)

        def price(polygon, mesh=mesh):
            """Least penalty over all triangulations of a polygon, by trying every apex."""
            if len(polygon) < 3:
                return 0.0
            best = math.inf
            for m in range(1, len(polygon) - 1):
                a, b, c = (int(polygon[i]) for i in (0, m, -1))
                if not ample(*np.stack([mesh.x, mesh.y], 1)[[a, b, c]].ravel()):
                    continue
                own = penalty(mesh, inner_of(f, mesh, TOL, a, b, c)[0])
                for p, q, inside in ((a, b, m > 1), (b, c, m < len(polygon) - 2)):
                    if inside:
                        own += penalty(mesh, edge_of(f, mesh, TOL, p, q)[0])
                best = min(best, own + price(polygon[: m + 1]) + price(polygon[m:]))
            return best

        around = (start + np.arange(9)) % 8
        chord = penalty(mesh, edge_of(f, mesh, TOL, start, end)[0])
        half = (end - start) % 8
        expected = price(around[: half + 1]) + price(around[half:]) + chord
        assert found == pytest.approx(expected, rel=1e-2)
        t, k = np.nonzero((mesh.wall == 1) & (mesh.tv[:, :1] >= 0))
        assert len(t) == 2
        assert set(mesh.tv[t, k]) == {start, end}


@pytest.mark.parametrize("height", [1e-4, 1e-8])
def test_a_vertex_too_near_to_the_border_goes_onto_it(height):
    """Splits of edges beside the border would otherwise come nearer by half each time."""
    plane = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1 + height]])
    ring = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    triangles = constrained_delaunay(plane, ring)
    F = field()
    z = np.array([value(F, *p) for p in plane])
    kind = np.array([FIXED] * 4 + [FREE], np.int8)
    mesh = build(
        np.column_stack([plane, z]), triangles, kind, np.zeros(5, np.int64),
        np.hstack([plane[:4], np.roll(plane[:4], -1, axis=0)]),
    )  # fmt: skip
    evaluate_all(F, mesh, TOL)
    t, k = next(
        (t, k) for t in range(len(triangles)) for k in range(3)
        if {mesh.tv[t, k], mesh.tv[t, (k + 1) % 3]} == {0, 4}
    )  # fmt: skip
    v = split_edge(F, mesh, TOL, t, k, 0.5)
    assert v == 5
    if height > 1e-6:
        assert mesh.kind[v] == FREE
        assert mesh.y[v] == pytest.approx(-1 + height / 2)
    else:
        assert (mesh.kind[v], mesh.side[v], mesh.y[v]) == (SLIDES, 0, -1.0)
        assert mesh.x[v] == pytest.approx(-0.5)
