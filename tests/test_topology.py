"""A mesh that changes in place: whatever is done to it, it stays a mesh; what is undone is gone."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from meshes import DOMAINS, TOL, assert_mesh, assert_same, live, make, raster, smooth

from equimesh.fields.dispatch import edge_error, inner_error, value
from equimesh.optimise.energy import (
    edge_of,
    evaluate_all,
    penalty,
    set_edge,
    set_inner,
    worst_of,
)
from equimesh.optimise.flips import try_flip
from equimesh.optimise.insertion import split_edge, split_inside
from equimesh.optimise.mesh import FIXED, FREE, GONE, build, compact, enlarged
from equimesh.optimise.moves import move_vertex, star_energy
from equimesh.optimise.removal import remove_if_clean, remove_vertex, touched_excess
from equimesh.optimise.topology import ample, begin, commit, flip, positive, rollback, star

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(params=["smooth square", "smooth hole", "raster square"], scope="module")
def case(request):
    """(domain, field, scale, shift, area)"""
    kind, name = request.param.split()
    domain = DOMAINS[name]
    if kind == "smooth":
        return domain, smooth(domain), 1.0, 0.0
    return domain, raster(domain), 5.0, 6.0


def may_flip(mesh, t, k):
    u = mesh.tn[t, k]
    if u < 0:
        return False
    a, b, c = mesh.tv[t, k], mesh.tv[t, (k + 1) % 3], mesh.tv[t, (k + 2) % 3]
    (j,) = (j for j in range(3) if mesh.tn[u, j] == t and mesh.tv[u, j] == b)
    d = mesh.tv[u, (j + 2) % 3]
    return all(
        positive(*(m for v in tri for m in (mesh.x[v], mesh.y[v])))
        for tri in ((c, a, d), (d, b, c))
    )


def change(field, mesh, rng, number):
    """``number`` random operations of every kind; returns how many took place."""
    made = np.zeros(6, int)
    for _ in range(number):
        t = int(rng.choice(np.flatnonzero(mesh.tv[:, 0] >= 0)))
        v = int(rng.choice(np.flatnonzero(mesh.kind != GONE)))
        k, what = int(rng.integers(3)), int(rng.integers(6))
        if what == 0 and may_flip(mesh, t, k):
            u = flip(mesh, t, k)
            e, s = edge_of(field, mesh, TOL, mesh.tv[t, 2], mesh.tv[t, 0])
            set_edge(mesh, t, 2, e, s)
            set_inner(field, mesh, TOL, t)
            set_inner(field, mesh, TOL, u)
            made[0] += 1
        elif what == 1:
            made[1] += try_flip(field, mesh, TOL, t, k)
        elif what == 2:
            made[2] += move_vertex(field, mesh, TOL, v) > 0
        elif what == 3:
            made[3] += remove_vertex(field, mesh, TOL, v, 1e9) >= 0
        elif what == 4:
            w = rng.dirichlet([2, 2, 2])
            x, y = w @ mesh.x[mesh.tv[t]], w @ mesh.y[mesh.tv[t]]
            made[4] += split_inside(field, mesh, TOL, t, x, y) >= 0
        elif what == 5:
            made[5] += split_edge(field, mesh, TOL, t, k, rng.uniform(0.2, 0.8)) >= 0
    return made


@given(seed=SEEDS)
@example(seed=0)
@settings(max_examples=12)
def test_whatever_is_done_it_stays_a_mesh(case, seed):
    domain, field, scale, shift = case
    mesh = make(domain, seed, field, scale, shift)
    assert_mesh(mesh, domain, scale, field)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        change(field, mesh, rng, 15)
        assert_mesh(mesh, domain, scale, field)


@given(seed=SEEDS, number=st.integers(1, 60))
@example(seed=0, number=60)
@settings(max_examples=25)
def test_rollback_gives_back_every_live_slot(case, seed, number):
    domain, field, scale, shift = case
    mesh = make(domain, seed, field, scale, shift)
    rng = np.random.default_rng(seed)
    change(field, mesh, rng, 10)  # so that there are spare slots
    before = live(mesh)
    begin(mesh)
    change(field, mesh, rng, number)
    rollback(mesh)
    assert_same(before, live(mesh))
    change(field, mesh, rng, 10)
    assert_mesh(mesh, domain, scale, field)


@given(seed=SEEDS)
@example(seed=1)
@settings(max_examples=10)
def test_commit_keeps_what_was_done_and_gives_slots_back(case, seed):
    domain, field, scale, shift = case
    mesh = make(domain, seed, field, scale, shift)
    rng = np.random.default_rng(seed)
    for keep in (True, False, True, True):
        before = live(mesh)
        begin(mesh)
        change(field, mesh, rng, 12)
        during = live(mesh)
        if keep:
            commit(mesh)
            assert_same(during, live(mesh))
        else:
            rollback(mesh)
            assert_same(before, live(mesh))
    assert_mesh(mesh, domain, scale, field)


def test_every_operation_takes_place_somewhere(case):
    domain, field, scale, shift = case
    made = np.zeros(6, int)
    for seed in range(6):
        mesh = make(domain, seed, field, scale, shift)
        made += change(field, mesh, np.random.default_rng(seed), 60)
    assert made.min() >= 3


@given(seed=SEEDS)
@example(seed=0)
@settings(max_examples=10)
def test_moves_and_flips_lower_the_penalty_around_them(case, seed):
    domain, field, scale, shift = case
    mesh = make(domain, seed, field, scale, shift)

    def total():
        t = np.flatnonzero(mesh.tv[:, 0] >= 0)
        inner = sum(penalty(mesh, e) for e in mesh.ie[t])
        both = [
            penalty(mesh, mesh.ee[s, k]) * (0.5 if mesh.tn[s, k] >= 0 else 1.0)
            for s in t
            for k in range(3)
        ]
        return inner + sum(both)

    now = total()
    for v in np.flatnonzero(mesh.kind != GONE):
        gain = move_vertex(field, mesh, TOL, v)
        after = total()
        assert after == pytest.approx(now - gain, abs=1e-9 * now)
        assert gain >= 0
        now = after
    for t in np.flatnonzero(mesh.tv[:, 0] >= 0):
        for k in range(3):
            if try_flip(field, mesh, TOL, t, k):
                after = total()
                assert after < now
                now = after


@given(seed=SEEDS)
@example(seed=0)
@settings(max_examples=10)
def test_fixed_vertices_never_move_and_sliding_ones_keep_to_their_side(case, seed):
    domain, field, scale, shift = case
    mesh = make(domain, seed, field, scale, shift)
    fixed = np.flatnonzero(mesh.kind == FIXED)
    place = mesh.x[fixed].copy(), mesh.y[fixed].copy()
    rng = np.random.default_rng(seed)
    for _ in range(3):
        for v in np.flatnonzero(mesh.kind != GONE):
            move_vertex(field, mesh, TOL, v)
        change(field, mesh, rng, 5)
    assert np.array_equal(place[0], mesh.x[fixed])
    assert np.array_equal(place[1], mesh.y[fixed])
    assert (mesh.kind[fixed] == FIXED).all()


def test_removal_fills_the_hole_with_the_least_penalty():
    # A regular star around one vertex: the filling is compared with all 14 of a hexagon.
    field = smooth(DOMAINS["square"])
    rng = np.random.default_rng(4)
    for _ in range(20):
        angle = 2 * math.pi * (np.arange(6) + rng.uniform(-0.2, 0.2, 6)) / 6
        ring = 0.6 * np.stack([np.cos(angle), np.sin(angle)], 1)
        plane = np.vstack([ring, [[0.05, 0.02]]])
        z = np.array([value(field, *p) for p in plane])
        spokes = np.stack([np.full(6, 6), np.arange(6), (np.arange(6) + 1) % 6], 1)
        sides = np.hstack([ring, np.roll(ring, -1, axis=0)])
        kind = np.array([FIXED] * 6 + [FREE], np.int8)
        mesh = build(np.column_stack([plane, z]), spokes, kind, np.zeros(7, np.int64), sides)
        evaluate_all(field, mesh, TOL)
        found = remove_vertex(field, mesh, TOL, 6, 1e9)
        assert found >= 0
        points = np.column_stack([plane, z])

        def price(polygon, points=points, mesh=mesh):
            """Least penalty over all triangulations of a polygon, by trying every apex."""
            if len(polygon) < 3:
                return 0.0
            first, last = polygon[0], polygon[-1]
            best = math.inf
            for m in range(1, len(polygon) - 1):
                a, b, c = points[first], points[polygon[m]], points[last]
                if not ample(*a[:2], *b[:2], *c[:2]):
                    continue
                own = penalty(mesh, inner_error(field, *a, *b, *c, 1e3 * TOL)[0] / TOL)
                for p, q, inside in ((a, b, m > 1), (b, c, m < len(polygon) - 2)):
                    if inside:
                        own += penalty(mesh, edge_error(field, *p, *q, 1e3 * TOL)[0] / TOL)
                best = min(best, own + price(polygon[: m + 1]) + price(polygon[m:]))
            return best

        assert found == pytest.approx(price(list(range(6))), rel=1e-9)


def test_a_clean_removal_leaves_no_violation(case):
    domain, field, scale, shift = case
    removed = 0
    for seed in range(5):
        mesh = make(domain, seed, field, scale, shift, inner=200)
        for v in np.flatnonzero(mesh.kind == FREE):
            before = live(mesh)
            if remove_if_clean(field, mesh, TOL, v):
                removed += 1
                assert mesh.kind[v] == GONE
                changed = [t for t in np.flatnonzero(mesh.tv[:, 0] >= 0)
                           if t not in before["t"]]  # fmt: skip
                assert all(worst_of(mesh, t) <= 1.0 for t in changed)
            else:
                assert_same(before, live(mesh))
    assert removed > 10


def test_excess_counts_each_touched_triangle_once(case):
    domain, field, scale, shift = case
    mesh = make(domain, 7, field, scale, shift)
    begin(mesh)
    change(field, mesh, np.random.default_rng(7), 25)
    touched = {int(t) for t in mesh.log_ti[: mesh.count[4], 0] if mesh.tv[t, 0] >= 0}
    expected = sum(max(0.0, worst_of(mesh, t) - 1.0) ** 2 for t in touched)
    assert touched_excess(mesh) == pytest.approx(expected, rel=1e-12)
    rollback(mesh)


def test_a_larger_mesh_has_the_same_content(case):
    domain, field, scale, shift = case
    mesh = make(domain, 3, field, scale, shift)
    change(field, mesh, np.random.default_rng(3), 20)
    before = live(mesh)
    grown = enlarged(mesh)
    assert_same(before, live(grown))
    assert len(grown.tv) == 2 * len(mesh.tv)
    change(field, grown, np.random.default_rng(4), 40)
    assert_mesh(grown, domain, scale, field)


def test_compact_renumbers_without_gaps(case):
    domain, field, scale, shift = case
    mesh = make(domain, 5, field, scale, shift)
    change(field, mesh, np.random.default_rng(5), 40)
    points, triangles, kind, side = compact(mesh)
    assert len(points) == len(kind) == len(side)
    assert sorted(np.unique(triangles)) == list(range(len(points)))
    u, w = (points[triangles[:, k], :2] - points[triangles[:, 0], :2] for k in (1, 2))
    area = 0.5 * (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0])
    assert area.min() > 0
    assert area.sum() == pytest.approx(domain.area * scale**2, rel=1e-12)


def test_walls_are_never_flipped_and_stay_when_split():
    domain = DOMAINS["square"]
    field = smooth(domain)
    plane = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0.1]], float)
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    z = np.array([value(field, *p) for p in plane])
    sides = np.hstack([plane[:4], np.roll(plane[:4], -1, axis=0)])
    kind = np.array([FIXED] * 4 + [FREE], np.int8)
    mesh = build(np.column_stack([plane, z]), triangles, kind, np.zeros(5, np.int64), sides,
                 np.array([[0, 4]]))  # fmt: skip
    evaluate_all(field, mesh, TOL)
    assert mesh.wall.sum() == 2
    assert remove_vertex(field, mesh, TOL, 4, 1e9) < 0
    (t, k) = next((t, k) for t in range(4) for k in range(3) if mesh.wall[t, k])
    assert not try_flip(field, mesh, TOL, t, k)
    v = split_edge(field, mesh, TOL, t, k, 0.5)
    assert mesh.kind[v] == FIXED
    assert mesh.wall.sum() == 4
    walls = {tuple(sorted((int(mesh.tv[s, j]), int(mesh.tv[s, (j + 1) % 3]))))
                    for s, j in np.argwhere(mesh.wall)}  # fmt: skip
    assert walls == {(0, v), (4, v)}


def test_the_star_energy_is_the_sum_of_its_parts(case):
    domain, field, scale, shift = case
    mesh = make(domain, 11, field, scale, shift)
    for v in np.flatnonzero(mesh.kind != GONE):
        n, closed = star(mesh, v)
        total, spokes = 0.0, set()
        for t in np.flatnonzero((mesh.tv == v).any(1)):
            total += penalty(mesh, mesh.ie[t])
            for k in range(3):
                ends = tuple(sorted((mesh.tv[t, k], mesh.tv[t, (k + 1) % 3])))
                if v in ends and ends not in spokes:
                    spokes.add(ends)
                    total += penalty(mesh, mesh.ee[t, k])
        assert star_energy(mesh, n, closed) == pytest.approx(total, rel=1e-12)
