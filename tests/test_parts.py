"""A mesh in parts: cut and closed it is the same; changed at once, by any number of threads, it is
a mesh, and one as good as if its vertices had come one after another."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import DOMAINS, TOL, assert_mesh, assert_same, live, make, smooth
from surfaces import FRANKE

import equimesh
from equimesh.fields.workers import apart
from equimesh.optimise import parts, sweep, trials
from equimesh.optimise.flips import flip_all
from equimesh.optimise.insertion import split_edge
from equimesh.optimise.mesh import FREE, GONE, HELD, SEAM
from equimesh.optimise.relax import make_queue
from equimesh.optimise.topology import star

SEEDS = st.integers(0, 2**32 - 1)
FIELDS = {name: smooth(domain) for name, domain in DOMAINS.items()}


@pytest.fixture(params=["square", "hole"], scope="module")
def name(request):
    return request.param


def vertices_of(mesh):
    return np.flatnonzero(mesh.kind != GONE)


@settings(max_examples=25)
@given(seed=SEEDS, halvings=st.integers(1, 3))
def test_what_was_cut_and_closed_again_is_the_same_mesh(name, seed, halvings):
    mesh = make(DOMAINS[name], seed, FIELDS[name], inner=200)
    before, listed = live(mesh), vertices_of(mesh)
    pieces, inside = parts._cut(mesh, listed, halvings)
    assert len(pieces) == 2**halvings
    assert (mesh.kind >= HELD).any()
    assert (mesh.wall >= SEAM).any()
    seen = set()
    for k, piece in enumerate(pieces):
        mine = np.flatnonzero(inside == k)
        for v in mine:  # its star is whole, and is no other part's
            n, closed = star(piece, v)
            assert closed == (mesh.kind[v] == FREE)
            around = set(piece.ring[1, :n].tolist())
            assert not around & seen
        seen |= set(np.flatnonzero((np.isin(mesh.tv, mine)).any(1)).tolist())
    parts._join(mesh, pieces)
    after = live(mesh)
    del before["v2t"], after["v2t"]  # any triangle of a vertex will do
    assert_same(before, after)
    assert_mesh(mesh, DOMAINS[name], 1.0, FIELDS[name])


def test_an_edge_on_a_seam_is_not_split(name):
    field, mesh = FIELDS[name], make(DOMAINS[name], 0, FIELDS[name], inner=200)
    pieces, _ = parts._cut(mesh, vertices_of(mesh), 1)
    seams = np.argwhere((mesh.wall >= SEAM) & (mesh.tv[:, :1] >= 0))
    assert len(seams) > 10
    for t, k in seams:
        assert split_edge(field, pieces[0], TOL, t, k, 0.5) == -1


@given(seed=SEEDS, share=st.floats(0.02, 1.0), size=st.sampled_from([0, 100, 10_000]))
def test_every_row_has_its_turn_once_and_in_order(seed, share, size):
    mesh = make(DOMAINS["square"], seed, FIELDS["square"], inner=150)
    rng = np.random.default_rng(seed)
    listed = rng.permutation(vertices_of(mesh))
    listed = listed[: max(1, int(share * len(listed)))]
    turns = []

    def work(mesh, queue, rows):
        assert (np.diff(rows) > 0).all()
        turns.append(rows)
        return len(rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "_HALVED", (size, 4 * size))
        assert parts.in_parts(mesh, make_queue(len(mesh.x)), listed, work, 1e9) == len(listed)
    assert sorted(np.concatenate(turns)) == list(range(len(listed)))
    assert (len(turns) == 1) == (size == 10_000)


def changed(name, seed, threads, halved=(100, 400)):
    """A mesh after vertices were moved, removed and inserted in parts, by so many threads."""
    field, mesh = FIELDS[name], make(DOMAINS[name], seed, FIELDS[name], inner=300)
    queue = make_queue(len(mesh.x))
    stamp = np.zeros(len(mesh.x), np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "_HALVED", halved)
        patch.setattr("numba.config.NUMBA_NUM_THREADS", threads)
        flip_all(field, mesh, TOL, 50)
        sweep.relax_everything(field, mesh, TOL, queue, 4)
        before = len(vertices_of(mesh))
        listed = np.flatnonzero(mesh.kind == FREE)
        removed = trials.removal_round(field, mesh, TOL, queue, listed, 60, 30.0, stamp, 1)
        assert len(vertices_of(mesh)) == before - removed
        sweep.relax_all(field, mesh, TOL, queue, 12)
    return mesh, removed


@settings(max_examples=8)
@given(seed=SEEDS)
def test_a_mesh_that_was_changed_in_parts_is_a_mesh(name, seed):
    mesh, removed = changed(name, seed, 2)
    assert removed > 10
    assert_mesh(mesh, DOMAINS[name], 1.0, FIELDS[name])
    assert (mesh.kind < HELD).all()
    assert (mesh.wall < SEAM).all()


@settings(max_examples=8)
@given(seed=SEEDS)
def test_threads_do_not_change_a_bit(seed):
    one, two, five = (live(changed("hole", seed, threads)[0]) for threads in (1, 2, 5))
    assert_same(one, two)
    assert_same(one, five)


def test_parts_find_as_much_as_one_after_another():
    whole, cut = (
        sum(changed("square", seed, 2, halved)[1] for seed in range(12))
        for halved in ((10_000,), (100, 400))
    )
    assert cut == pytest.approx(whole, rel=0.02)


def test_a_mesh_made_in_parts_keeps_its_lines_and_its_tolerance(monkeypatch):
    cuts = []
    cut = parts._cut
    monkeypatch.setattr(parts, "_cut", lambda *given: cuts.append(1) or cut(*given))
    line = shapely.LineString([(0.1, 0.2), (0.55, 0.5), (0.9, 0.85)])
    result = equimesh.remesh(FRANKE, 1e-3, (0, 0, 1, 1), constraints=[line])
    assert len(cuts) > 5
    assert result.status.ok
    kept = shapely.union_all(shapely.linestrings(result.points[result.constraints.edges][..., :2]))
    assert kept.length == pytest.approx(line.length, rel=1e-9)
    assert kept.hausdorff_distance(line) < 1e-9
    assert len(result.triangles) < 1.1 * result.lower_bound


def test_counts_that_threads_write_lie_apart():
    number = np.arange(5)
    own = apart(number)
    np.testing.assert_array_equal(own, number)
    start, end = np.lib.array_utils.byte_bounds(own.base)
    first, last = np.lib.array_utils.byte_bounds(own)
    assert min(first - start, end - last) >= 128
