"""Scans as they come: damage is repaired and told, or refused in one sentence with its place."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.fields.surface_topology import opposites

few = settings(max_examples=60, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def sheet(n=12):
    """(n n, 3) points of a smooth surface over the unit square and their triangles."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    z = 0.3 * np.sin(4 * x) * np.exp(y)
    cell = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k.ravel() for k in (cell[:-1, :-1], cell[:-1, 1:], cell[1:, 1:], cell[1:, :-1]))
    return np.stack([x, y, z], 1), np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def without_disc(points, triangles, x, y, radius):
    middle = points[triangles].mean(axis=1)
    return triangles[np.hypot(middle[:, 0] - x, middle[:, 1] - y) > radius]


def soup(points, triangles):
    return points[triangles].reshape(-1, 3), np.arange(triangles.size).reshape(-1, 3)


def turned(points, triangles):
    triangles = triangles.copy()
    triangles[::5] = triangles[::5, ::-1]
    return points, triangles


def flap(points, triangles):
    edge = triangles[60, :2]
    more = np.vstack([points, points[edge].mean(axis=0) + np.array([0.003, 0.004, 0.5])])
    return more, np.vstack([triangles, [*edge, len(points)]])


def two_flaps(points, triangles):
    points, triangles = flap(points, triangles)
    return np.vstack([points, points[-1] + [0.01, 0.0, 0.2]]), np.vstack(
        [triangles, [*triangles[-1, :2], len(points)]]
    )


def wall(points, triangles):
    """A strip of two triangles that stands on the sheet: no single flap."""
    a, b = triangles[60, :2]
    top = points[[a, b]] + [0.0, 0.0, 1.0]
    n = len(points)
    return np.vstack([points, top]), np.vstack([triangles, [a, b, n + 1], [a, n + 1, n]])


def moebius(points, triangles):
    n = 12
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    across = np.stack(
        [np.cos(angle) * np.cos(angle / 2), np.sin(angle) * np.cos(angle / 2), np.sin(angle / 2)], 1
    )
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    k = np.arange(n - 1)
    faces = np.vstack([np.stack([k, k + 1, k + n], 1), np.stack([k + 1, k + n + 1, k + n], 1)])
    faces = np.vstack([faces, [[n - 1, n, 2 * n - 1], [n, 0, 2 * n - 1]]])
    return np.vstack([ring + 0.3 * across, ring - 0.3 * across]), faces


def doubled_sheet(points, triangles):
    return np.vstack([points, points + np.array([0.31, 0.17, 0.5])]), np.vstack(
        [triangles, triangles + len(points)]
    )


def folded(points, triangles):
    points = points.copy()
    points[40, :2] += 0.3
    return points, triangles


def not_a_number(points, triangles):
    points = points.copy()
    points[40, 2] = np.nan
    return points, triangles


def stray_points(points, triangles):
    return np.vstack([points, [[9, 9, 9], [np.nan, 0, 0]]]), triangles


def mirrored(points, triangles):
    return points, triangles[:, ::-1]


def hanging_vertex(points, triangles):
    a, b, c = triangles[60]
    n = len(points)
    more = np.vstack([points, points[[a, b]].mean(axis=0)])
    rest = np.delete(triangles, 60, axis=0)
    return more, np.vstack([rest, [a, n, c], [n, b, c]])


def in_pieces(points, triangles):
    middle = points[triangles].mean(axis=1)
    return points, triangles[(middle[:, 0] < 0.45) | (middle[:, 0] > 0.55)]


def bow_tie(points, triangles):
    x, y, _ = points[triangles].mean(axis=1).T
    return points, triangles[(x - 5 / 11) * (y - 5 / 11) > 0]


# a sheet, what is done to it, and what the notes or the refusal say
REPAIRED = {
    "every triangle with points of its own": (soup, "merged"),
    "windings against the neighbours": (turned, "wound against"),
    "a triangle given twice": (lambda p, t: (p, np.vstack([t, t[7]])), "given twice"),
    "a triangle given twice, turned": (lambda p, t: (p, np.vstack([t, t[7, ::-1]])), "given twice"),
    "all triangles twice": (lambda p, t: (p, np.vstack([t, t])), "given twice"),
    "a triangle with two equal corners": (
        lambda p, t: (p, np.vstack([t, [3, 3, 4]])), "same place",
    ),
    "a triangle that is a point": (lambda p, t: (p, np.vstack([t, [3, 3, 3]])), "same place"),
    "points of no triangle": (stray_points, "of no triangle"),
    "a triangle without area on the border": (
        lambda p, t: (np.vstack([p, 0.5 * (p[0] + p[1])]), np.vstack([t, [1, 0, len(p)]])),
        "without area",
    ),
    "a flap on an edge": (flap, "hanging on an edge"),
    "two flaps on one edge": (two_flaps, "hanging on an edge"),
    "soup with windings lost": (lambda p, t: turned(*soup(p, t)), "merged"),
    "mirrored soup with strays": (lambda p, t: stray_points(*soup(p, t[:, ::-1])), "merged"),
}  # fmt: skip
ACCEPTED = {
    "seen from below": mirrored,
    "pieces": in_pieces,
    "pieces that meet in a vertex": bow_tie,
    "a hole": lambda p, t: (p, without_disc(p, t, 0.5, 0.5, 0.2)),
    "a vertex hanging on an edge": hanging_vertex,
    "one triangle": lambda p, t: (p, t[:1]),
}
REFUSED = {
    "a wall on the sheet": (wall, "more than two", True),
    "a Moebius band": (moebius, "one-sided", True),
    "two sheets": (doubled_sheet, "over one another", True),
    "a fold": (folded, "turned over", True),
    "a coordinate that is not a number": (not_a_number, "not finite", False),
    "no triangle": (lambda p, t: (p, t[:0]), "no triangles", False),
    "all corners the same": (lambda p, t: (p, np.zeros((4, 3), int)), "with an area", False),
    "an index beyond the points": (lambda p, t: (p, t + 1), "number vertices", False),
    "an index below zero": (lambda p, t: (p, t - 1), "number vertices", False),
    "a needle": (lambda p, t: (p * [1, 0, 0], t), "no", False),
    "points in the plane": (lambda p, t: (p[:, :2], t), "(n, 3)", False),
}


@pytest.mark.parametrize("name", REPAIRED)
def test_harmless_damage_is_repaired_and_told(name):
    damage, told = REPAIRED[name]
    points, triangles = sheet()
    plain = Surface(points, triangles)
    surface = Surface(*damage(points, triangles))
    assert any(told in note for note in surface.notes)
    assert len(surface.triangles) == len(plain.triangles)
    assert shapely.equals(surface.outline(0.0), plain.outline(0.0))
    middle = points[triangles].mean(axis=1)
    assert surface.value(*middle[:, :2].T) == pytest.approx(middle[:, 2], abs=1e-13)


@pytest.mark.parametrize("name", ACCEPTED)
def test_odd_but_sound_surfaces_are_meshed(name):
    points, triangles = ACCEPTED[name](*sheet())
    surface = Surface(points, triangles)
    result = equimesh.remesh(surface, "5%")
    assert result.status.ok
    assert set(surface.notes) <= set(result.notes)
    projected = points[triangles][:, :, :2]
    u, v = projected[:, 1] - projected[:, 0], projected[:, 2] - projected[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    assert surface.outline(0.0).area == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("name", REFUSED)
def test_other_damage_is_refused_in_one_sentence_with_its_place(name):
    damage, says, placed = REFUSED[name]
    with pytest.raises(InputError, match=re.escape(says)) as caught:
        Surface(*damage(*sheet()))
    text = str(caught.value)
    assert text.endswith(".")
    assert ". " not in text
    assert not placed or re.search(r"\(-?[\d.e-]+, -?[\d.e-]+, -?[\d.e-]+\)", text)


def test_place_of_a_fold_is_in_the_coordinates_of_the_input():
    points, triangles = folded(*sheet())
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    with pytest.raises(InputError, match="turned over") as caught:
        Surface(points @ axes, triangles, up=axes.T @ [0.0, 0, 1])
    found = re.search(r"near \((.*?), (.*?), (.*?)\)", str(caught.value))
    assert found
    near = axes @ np.array([float(word) for word in found.groups()])
    around = triangles[(triangles == 40).any(axis=1)]
    distance = np.linalg.norm(points[around].mean(axis=1) - near, axis=1)
    assert distance.min() < 1e-4


@few
@given(seeds, st.data())
def test_any_damage_is_repaired_or_refused_in_one_sentence(seed, data):
    rng = np.random.default_rng(seed)
    points, triangles = sheet(6)
    for _ in range(data.draw(st.integers(1, 3))):
        kind = data.draw(st.integers(0, 7))
        pick = rng.integers(0, len(triangles), 3)
        if kind == 0:
            triangles = np.delete(triangles, pick, axis=0)
        elif kind == 1:
            triangles[pick] = triangles[pick][:, ::-1]
        elif kind == 2:
            triangles = np.vstack([triangles, rng.permuted(triangles[pick], axis=1)])
        elif kind == 3:
            triangles[pick[0], 0] = rng.integers(0, len(points))
        elif kind == 4:
            points[rng.integers(0, len(points))] += rng.normal(0, 0.1, 3)
        elif kind == 5:
            points = np.vstack([points, points])
            triangles = triangles + rng.choice([0, len(points) // 2], (len(triangles), 1))
        elif kind == 6:
            points[rng.integers(0, len(points))] = points[rng.integers(0, len(points))]
        else:
            triangles = np.vstack([triangles, rng.integers(0, len(points), (1, 3))])
    try:
        surface = Surface(points, triangles)
    except InputError as error:
        text = str(error)
        assert text.endswith(".")
        assert ". " not in text
        return
    changed = len(surface.triangles) != len(triangles) or len(surface.points) != len(points)
    assert bool(surface.notes) or not changed
    assert surface.outline(0.0).is_valid
    count = np.bincount(opposites(surface.triangles)[opposites(surface.triangles) >= 0])
    assert count.max(initial=0) <= 1
    middle = surface.points[surface.triangles].mean(axis=1)
    assert surface.value(*middle[:, :2].T) == pytest.approx(middle[:, 2], abs=1e-9)


def holes(surface):
    return sum(len(part.interiors) for part in shapely.get_parts(surface.outline(0.0)))


def test_holes_up_to_a_size_are_closed():
    points, triangles = sheet(30)
    small = without_disc(points, triangles, 0.25, 0.3, 0.08)
    both = without_disc(points, small, 0.7, 0.6, 0.2)
    kept = Surface(points, both)
    assert holes(kept) == 2
    areas = sorted(shapely.Polygon(r).area for r in kept.outline(0.0).interiors)
    middle = 0.5 * sum(areas)
    one = Surface(points, both, fill_holes=middle)
    assert holes(one) == 1
    assert one.outline(0.0).area == pytest.approx(kept.outline(0.0).area + areas[0])
    assert any(re.match(r"closed 1 hole with \d+ triangles", note) for note in one.notes)
    full = Surface(points, both, fill_holes="all")
    assert holes(full) == 0
    assert full.outline(0.0).area == pytest.approx(1.0)
    assert any("closed 2 holes" in note for note in full.notes)
    assert kept.closed("all").outline(0.0).area == pytest.approx(1.0)
    edges = sorted(len(r.coords) - 1 for r in kept.outline(0.0).interiors)
    by_edges = Surface(points, both, fill_holes=f"{edges[0]} edges")
    assert holes(by_edges) == 1
    assert holes(Surface(points, both, fill_holes=f"{edges[0] - 1} edges")) == 2


def test_closed_holes_are_flat_between_their_rims():
    points, triangles = sheet(30)
    points[:, 2] = 2.0 * points[:, 0] - points[:, 1]
    surface = Surface(points, without_disc(points, triangles, 0.5, 0.5, 0.2), fill_holes="all")
    x, y = np.random.default_rng(0).uniform(0.3, 0.7, (2, 200))
    assert surface.value(x, y) == pytest.approx(2.0 * x - y, abs=1e-12)
    result = equimesh.remesh(surface, 1e-3)
    assert result.status.ok
    assert len(result.triangles) == 2
    assert any("closed 1 hole" in note for note in result.notes)


def test_holes_with_an_island_stay():
    points, triangles = sheet(30)
    x, y, _ = points[triangles].mean(axis=1).T
    away = np.hypot(x - 0.5, y - 0.5)
    surface = Surface(points, triangles[(away < 0.15) | (away > 0.3)], fill_holes="all")
    assert holes(surface) == 1
    assert not any("closed" in note for note in surface.notes)


@few
@given(seeds)
def test_a_ragged_scan_stays_a_graph_when_its_holes_are_closed(seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 1, (80, 2))
    triangles = Delaunay(xy).simplices
    points = np.column_stack([xy, rng.normal(size=80)])
    kept = triangles[rng.random(len(triangles)) > 0.25]
    ragged = Surface(points, kept)
    closed = Surface(points, kept, fill_holes="all")
    hull = shapely.area(
        shapely.polygons([p.exterior for p in shapely.get_parts(ragged.outline(0.0))])
    )
    assert closed.outline(0.0).is_valid
    assert closed.outline(0.0).area <= hull.sum() + 1e-12
    middle = points[kept].mean(axis=1)
    assert closed.value(*middle[:, :2].T) == pytest.approx(middle[:, 2], abs=1e-9)


@pytest.mark.parametrize("size", ["many", "3 holes", -1.0, np.nan, None, "x edges"])
def test_unknown_sizes_of_holes_are_refused(size):
    with pytest.raises(InputError, match="fill_holes"):
        Surface(*sheet(), fill_holes=size)
