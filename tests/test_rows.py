"""Rows of saddles: straight where the metric is flat, and along det H = 0."""

from __future__ import annotations

import math

import lattices
import numpy as np
import pytest
import shapely

from equimesh import rows, seeding
from equimesh.fields import Function

SQUARE = shapely.box(-1, -1, 1, 1)


def only(monkeypatch, kind):
    """Lay rows of one kind, and nothing else."""
    other = {"_lay_beside": "_lay_strips", "_lay_strips": "_lay_beside"}[kind]
    monkeypatch.setattr(rows, other, lambda ground, front, count, seeds: count)
    monkeypatch.setattr(rows, "grow", lambda ground, front, count, begin, generations: count)
    monkeypatch.setattr(seeding, "sow", lambda ground, front, count, seeds: count)


def laid(text, tol, domain=SQUARE):
    """(n, 2) the vertices of the lattice with rows."""
    return lattices.laid(text, tol, domain, 50_000, rows=True)


def edge_errors(text, tol, points):
    """(n - 1,) signed error of the quadratic on the way to the next point, in units of tol."""
    step, middle = np.diff(points, axis=0), 0.5 * (points[1:] + points[:-1])
    hessian = Function(text).hessian(*middle.T)
    return np.einsum("ni,nij,nj->n", step, hessian, step) / (8.0 * tol)


@pytest.mark.parametrize("tol", [1e-3, 1e-4])
def test_rows_of_a_flat_metric_are_straight_lines_with_edges_of_the_tolerance(monkeypatch, tol):
    only(monkeypatch, "_lay_strips")
    text = "exp(x)*sin(y)*10"
    domain = shapely.box(0, 0, 2, 2)
    points = laid(text, tol, domain)
    # The flat coordinates of a harmonic function are those of the root of its second derivative.
    z = np.exp(0.5 * (points @ [1.0, 1.0j]))
    step, error = np.diff(z), edge_errors(text, tol, points)
    row = abs(abs(error) - 1.0) < 0.01
    assert row.mean() > 0.9  # from one row to the next, and from its one half to the other
    along = row[1:] & row[:-1]
    bent = abs(step[1:] - step[:-1]) / abs(step[1:])
    assert np.quantile(bent[along], 0.95) < 1e-3


@pytest.mark.parametrize("text", ["exp(x)*sin(y)*10", "x*y*(1+x**2+y**2)"])
def test_one_seed_brings_most_rows_since_each_begins_beside_another(monkeypatch, text):
    only(monkeypatch, "_lay_strips")
    every = len(laid(text, 1e-5))
    monkeypatch.setattr(rows, "_SEEDS", 1)
    first = len(laid(text, 1e-5))
    assert first > 0.6 * every


def test_rows_beside_a_circle_where_det_vanishes_are_circles(monkeypatch):
    only(monkeypatch, "_lay_beside")
    text, tol = "exp(-5*(x**2+y**2))", 2e-6
    points = laid(text, tol)
    radius, error = np.hypot(*points.T), edge_errors(text, tol, points)
    # det H has the factor 10 r^2 - 1, and the first rows leave room for what reaches across.
    assert (radius > math.sqrt(0.1)).all()
    assert len(points) > 200
    row = abs(error - 1.0) < 0.02  # along the circle the surface is bent as where it is concave
    assert (abs(error + 1.0) < 0.02).mean() + row.mean() > 0.95
    together = np.flatnonzero(abs(abs(error) - 1.0) < 0.02)
    assert abs(radius[together + 1] - radius[together]).max() < 1e-3 * radius.max()


def test_strips_are_the_narrower_the_more_the_metric_is_curved(monkeypatch):
    only(monkeypatch, "_lay_strips")
    text = "exp(-5*(x**2+y**2))"
    density = []
    for tol in (2e-5, 2.5e-6):
        points = laid(text, tol)
        density.append(len(points) * tol)  # a share of all vertices
    # Widths in edges grow like tol^(-1/3), and so does the number of vertices for each in a row.
    assert density[0] / density[1] == pytest.approx(8.0 ** (1.0 / 3.0), rel=0.25)


@pytest.mark.parametrize(
    "text", ["exp(-5*(x**2+y**2))", "sin(3*x)*cos(3*y)", "exp(x)*cos(x+3*y)", "x*y*(1+x**2)"]
)
def test_the_lattice_with_rows_has_as_many_vertices(monkeypatch, text):
    tol = 2e-4
    with_rows = len(laid(text, tol))
    monkeypatch.setattr(seeding, "grow_rows", lambda ground, front, count, seeds: count)
    assert with_rows == pytest.approx(len(laid(text, tol)), rel=0.03)
