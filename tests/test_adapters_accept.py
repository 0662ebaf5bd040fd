"""The instruments of the adapters' acceptance program see what they are to see."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def square(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("wave_square")


@pytest.fixture
def coarse(square):
    """A mesh for the wave's surface, which the instruments must accept."""
    import equimesh

    made = equimesh.remesh(equimesh.Surface(*square.surface()), square.TOL)
    return made.points, made.triangles


def test_a_good_mesh_is_accepted_and_every_fault_is_named(square, coarse):
    points, triangles = coarse
    values, labels = square.linear(points), square.halves(points, triangles)
    assert square.mesh_fault(points, triangles, values, labels) == ""
    lifted = points + np.array([0.0, 0.0, 1.1 * square.TOL])
    faults = [
        (lifted, triangles, values, labels, "tolerance"),
        (points, triangles[:, ::-1], values, labels, "counter-clockwise"),
        (points, triangles[1:], values, labels, "."),
        (points, triangles, values + 1e-8, labels, "linear value"),
        (points, triangles, values, 3 - labels, "labels"),
    ]
    for *given, word in faults:
        assert word in square.mesh_fault(*given)
    whole = square.surface()
    assert square.mesh_fault(
        *whole, square.linear(whole[0]), square.halves(*whole)
    ) == "no fewer triangles"  # fmt: skip


def test_equal_triangles_are_equal_in_any_order_of_vertices(square):
    made = square.result()
    order = np.random.default_rng(3).permutation(len(made.points))
    place = np.argsort(order)
    turned = np.roll(place[made.triangles], 1, axis=1)[::-1]
    assert square.same(made.points[order], turned, made) == ""
    assert square.same(made.points[order, :2], turned, made) == ""
    assert square.same(made.points[order], turned[:, ::-1], made) != ""
    assert square.same(np.nextafter(made.points, 2), made.triangles, made) != ""
    assert square.same(np.nextafter(made.points, 2), made.triangles, made, 1e-12) == ""
    fewer = replace(made, triangles=made.triangles[1:])
    assert "triangles of" in square.same(made.points, made.triangles, fewer)


def test_a_digest_sees_bytes_types_and_shapes(square):
    zeros = np.zeros((2, 3))
    assert square.digest(zeros) == square.digest(np.zeros((2, 3)))
    others = [zeros.T, zeros.astype(np.float32), zeros + 1e-300, -zeros]
    assert len({square.digest(array) for array in [zeros, *others]}) == 5
