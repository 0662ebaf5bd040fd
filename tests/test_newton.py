"""Steps of all vertices at once go downhill, end at the lattice and turn no triangle over."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from equimesh.fields.dispatch import value
from equimesh.fields.function import Function
from equimesh.optimise import newton, system
from equimesh.optimise.energy import evaluate_all, lift
from equimesh.optimise.mesh import (
    FIRM,
    FIXED,
    FREE,
    HARD,
    HARDER,
    HARDEST,
    MANNER,
    MODEL,
    SLIDES,
    SOFT,
    build,
)
from equimesh.optimise.newton import relax_together
from equimesh.optimise.sweep import lift_all
from equimesh.optimise.system import System, prices
from equimesh.triangulation import constrained_delaunay

POWERS = {"soft": SOFT, "firm": FIRM, "hard": HARD, "harder": HARDER, "hardest": HARDEST}
SQUARE = shapely.box(-1, -1, 1, 1)
SEEDS = st.integers(0, 2**32 - 1)
FIELDS = {
    text: Function(text).kernel(SQUARE, 1e-3)
    for text in ("x**2+y**2", "x**2-y**2", "exp(x)+x*y/2+y**2", "sin(2*x)*cos(2*y)+x**2/2")
}


def lattice(field, rows=4):
    """A hexagon of the triangular lattice around the origin; its rim is fixed."""
    step = 0.9 / rows
    i, j = np.meshgrid(np.arange(-rows, rows + 1), np.arange(-rows, rows + 1))
    i, j = (a[np.abs(i + j) <= rows] for a in (i, j))
    plane = step * np.stack([i + 0.5 * j, math.sqrt(0.75) * j], 1)
    rim = np.maximum(np.maximum(abs(i), abs(j)), abs(i + j)) == rows
    order = np.argsort(np.arctan2(plane[rim, 1], plane[rim, 0]))
    ring = np.flatnonzero(rim)[order]
    triangles = constrained_delaunay(plane, np.stack([ring, np.roll(ring, -1)], 1))
    z = np.array([value(field, *p) for p in plane])
    kind = np.where(rim, FIXED, FREE).astype(np.int8)
    return build(
        np.column_stack([plane, z]), triangles, kind, np.zeros(len(plane), np.int64),
        np.array([[-1.0, -1.0, 1.0, -1.0]]),
    )  # fmt: skip


def shaken(field, mesh, seed, by):
    """Every free vertex moved by up to ``by``."""
    rng = np.random.default_rng(seed)
    for v in np.flatnonzero(mesh.kind == FREE):
        dx, dy = rng.uniform(-by, by, 2)
        lift(field, mesh, v, mesh.x[v] + dx, mesh.y[v] + dy)


def total_of(mesh):
    """The energy of all triangles."""
    return prices(mesh, np.zeros(int(mesh.count[0])))


def gradient_of(field, mesh, tol):
    """(n, 2) derivative of the energy by every place, from the assembled system."""
    system = System(mesh)
    system.assemble(field, mesh, tol)
    return -system.downhill


@pytest.mark.parametrize("power", POWERS)
@pytest.mark.parametrize("text", ["x**2+y**2", "exp(x)+x*y/2+y**2"])
def test_the_assembled_slope_is_the_energys(text, power):
    """Against central differences: errors at their peaks are stationary in the peaks' places."""
    field, tol = FIELDS[text], 0.02
    mesh = lattice(field)
    shaken(field, mesh, 1, 0.03)
    mesh.count[MANNER] = POWERS[power]
    evaluate_all(field, mesh, tol)
    slope = gradient_of(field, mesh, tol)
    for v in np.flatnonzero(mesh.kind == FREE)[::5]:
        for axis in range(2):
            energies = []
            x, y = mesh.x[v], mesh.y[v]
            for sign in (1, -1):
                lift(field, mesh, v, x + sign * 1e-6 * (axis == 0), y + sign * 1e-6 * (axis == 1))
                evaluate_all(field, mesh, tol)
                energies.append(total_of(mesh))
            lift(field, mesh, v, x, y)
            found = (energies[0] - energies[1]) / 2e-6
            assert slope[v, axis] == pytest.approx(found, rel=2e-3, abs=2e-3 * np.abs(slope).max())


@pytest.mark.parametrize("modelled", [0, 1])
def test_a_shaken_lattice_comes_back(modelled):
    """The equilateral lattice is where the energy of x^2 + y^2 is least; vertices find it again."""
    field, tol = FIELDS["x**2+y**2"], 0.02
    mesh = lattice(field)
    there = np.stack([mesh.x, mesh.y], 1)
    shaken(field, mesh, 2, 0.04)
    mesh.count[MANNER], mesh.count[MODEL] = SOFT, modelled
    lift_all(field, mesh)
    evaluate_all(field, mesh, tol)
    for _ in range(10):  # each stops where a step gains less than it costs
        relax_together(field, mesh, tol, 40)
    assert np.abs(np.stack([mesh.x, mesh.y], 1) - there).max() < 2e-3


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.sampled_from(sorted(FIELDS)), st.sampled_from(sorted(POWERS)))
def test_energy_falls_and_no_triangle_turns_over(seed, text, power):
    field, tol = FIELDS[text], 0.01
    mesh = lattice(field)
    shaken(field, mesh, seed, 0.06)
    tv = mesh.tv[: mesh.count[0]].copy()
    mesh.count[MANNER] = POWERS[power]
    evaluate_all(field, mesh, tol)
    before = total_of(mesh)
    area = twice_areas(mesh)
    relax_together(field, mesh, tol, 5)
    assert total_of(mesh) <= before
    assert (mesh.tv[: mesh.count[0]] == tv).all()
    assert (twice_areas(mesh)[area > 0] > 0).all()
    stored = mesh.ee.copy(), mesh.ie.copy()
    evaluate_all(field, mesh, tol)
    for old, new in zip(stored, (mesh.ee, mesh.ie), strict=True):
        np.testing.assert_array_equal(old, new)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_steps_that_would_turn_triangles_are_taken_back(seed):
    """Alike in one kernel and in ranges."""
    field, tol = FIELDS["exp(x)+x*y/2+y**2"], 0.01
    step, places = None, []
    for alone in (True, False):
        mesh = lattice(field)
        mesh.count[MANNER] = SOFT
        evaluate_all(field, mesh, tol)
        steps = newton._Steps(field, mesh, tol)
        if step is None:
            step = np.random.default_rng(seed).uniform(-0.3, 0.3, steps.room.step.shape)
            x, y = mesh.x.copy(), mesh.y.copy()
            mesh.x[:61] += step[:, 0] * (mesh.kind[:61] == FREE)
            mesh.y[:61] += step[:, 1] * (mesh.kind[:61] == FREE)
            assert (twice_areas(mesh) < 0).any()
            mesh.x[:], mesh.y[:] = x, y
        steps.room.step[:] = step
        if alone:
            newton._move_alone(field, mesh, tol, steps.room)
        else:
            steps.moved()
        assert (twice_areas(mesh) > 0).all()
        places.append((mesh.x.copy(), mesh.y.copy(), mesh.ee.copy(), mesh.ie.copy()))
    for one, other in zip(*places, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("power", POWERS)
def test_one_kernel_steps_as_ranges_do(monkeypatch, power):
    field, tol = FIELDS["exp(x)+x*y/2+y**2"], 0.01
    monkeypatch.setattr(newton, "_LEFT", newton._LEFT_ALONE)
    monkeypatch.setattr(newton, "_ENOUGH", newton._ENOUGH_ALONE)
    ends = []
    for alone in (newton.ALONE, 0):
        monkeypatch.setattr(newton, "ALONE", alone)
        monkeypatch.setattr(system, "ALONE", alone)
        mesh = lattice(field)
        shaken(field, mesh, 4, 0.06)
        mesh.count[MANNER] = POWERS[power]
        evaluate_all(field, mesh, tol)
        assert relax_together(field, mesh, tol, 5) > 0
        ends.append((mesh.x, mesh.y, mesh.ee, mesh.ie))
    for one, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, other)


def test_one_bad_spot_does_not_stop_the_others():
    """A fixed vertex near another's place: its triangles' energy is beyond all others' sum."""
    field, tol = FIELDS["x**2+y**2"], 0.0075  # 0.15^2 / 3, the lattice's own error
    mesh = lattice(field, 6)
    there = np.stack([mesh.x, mesh.y], 1)
    shaken(field, mesh, 3, 0.03)
    free = np.flatnonzero(mesh.kind == FREE)
    bad = free[np.argmax(there[free, 0])]
    lift(field, mesh, bad, there[bad, 0] - 0.1, there[bad, 1])
    mesh.kind[bad] = FIXED
    mesh.count[MANNER] = FIRM
    evaluate_all(field, mesh, tol)
    assert np.abs(mesh.ie).max() ** 24 > 1e5 * np.median(np.abs(mesh.ie[: mesh.count[0]])) ** 24
    far = free[there[free, 0] < 0.0]

    def off():
        return np.hypot(mesh.x[far] - there[far, 0], mesh.y[far] - there[far, 1]).mean()

    before = off()
    relax_together(field, mesh, tol, 40)
    assert off() < 0.5 * before


def twice_areas(mesh):
    a, b, c = mesh.tv[: mesh.count[0]].T
    x, y = mesh.x, mesh.y
    return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])


def test_vertices_on_a_side_stay_on_it():
    field, tol = FIELDS["exp(x)+x*y/2+y**2"], 0.01
    mesh = lattice(field)
    low = np.flatnonzero(np.isclose(mesh.y, mesh.y[: mesh.count[1]].min()) & (mesh.kind == FIXED))
    low = low[np.argsort(mesh.x[low])]
    ends = mesh.x[low[0]], mesh.x[low[-1]]
    mesh.sides[0] = [ends[0], mesh.y[low[0]], ends[1], mesh.y[low[0]]]
    mesh.kind[low[1:-1]] = SLIDES
    was = mesh.x[low].copy()
    mesh.count[MANNER] = SOFT
    evaluate_all(field, mesh, tol)
    assert relax_together(field, mesh, tol, 10) > 0
    assert np.abs(mesh.y[low] - mesh.sides[0, 1]).max() < 1e-15
    assert (np.diff(mesh.x[low]) > 0).all()
    assert (mesh.x[low] != was).any()
