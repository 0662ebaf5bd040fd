"""Numbers of triangles given instead of a tolerance, or beside one."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import Delaunay
from typer.testing import CliRunner

import equimesh
from equimesh import InputError, Status, cli
from equimesh.target import first_tolerance
from equimesh_adapters.trimesh import remesh as remesh_trimesh

UNIT = (0, 0, 1, 1)
HARMONIC = "exp(5*x)*sin(5*y)"
RUNS = 6


def bowl(x, y):
    return np.exp(2 * x + y) + (x - 2 * y) ** 2


def raster():
    x, y = np.meshgrid(np.linspace(-2, 2, 61), np.linspace(-2, 2, 51))
    rough = np.random.default_rng(3).normal(size=x.shape)
    return x * np.exp(-(x**2) - y**2) + 0.002 * rough


def surface():
    p = np.random.default_rng(1).random((1500, 2))
    z = np.sin(4 * p[:, 0]) * p[:, 1]
    return equimesh.Surface(np.column_stack([p, z]), Delaunay(p).simplices)


def counted(source, domain=None, **options):
    """The result and how many meshes were made for it."""
    begun = []

    def progress(stage, fraction):
        begun.append((stage, fraction))

    result = equimesh.remesh(source, domain=domain, progress=progress, **options)
    return result, begun.count(("seed", 0.0))


SOURCES = {
    "expression": (HARMONIC, UNIT, 400),
    "callable": (bowl, UNIT, 300),
    "polygon": (bowl, shapely.Point(0.5, 0.5).buffer(0.5, 4), 300),
    "det H is 0": ("x**2 + y", UNIT, 200),
    "raster": (raster(), None, 300),
    "part of a raster": (raster(), (10, 5, 40, 45), 200),
    "surface": (surface(), None, 150),
}


@pytest.mark.parametrize("name", SOURCES)
def test_nearly_all_triangles_are_used_after_a_few_runs(name):
    source, domain, target = SOURCES[name]
    result, runs = counted(source, domain, target=target, effort="fast")
    assert 0.97 * target <= len(result.triangles) <= target
    assert result.status is Status.CONVERGED
    assert result.profile.bound <= result.tol
    assert runs <= RUNS
    finer = equimesh.remesh(source, 0.93 * result.tol, domain, effort="fast")
    assert len(finer.triangles) > target


def test_the_timings_are_those_of_all_runs():
    result, runs = counted(HARMONIC, UNIT, target=400, effort="fast")
    one = equimesh.remesh(HARMONIC, result.tol, UNIT, effort="fast")
    assert list(result.timings) == list(one.timings)
    assert runs >= 1


@pytest.mark.parametrize("target", [2, 3, 10, 37])
def test_few_triangles_and_the_tolerance_that_they_are_certified_for(target):
    result = equimesh.remesh("x*y + y**2", target=target, domain=UNIT, effort="fast")
    assert 2 <= len(result.triangles) <= target
    assert result.profile.bound <= result.tol <= result.profile.bound / 0.99
    assert result.lower_bound * result.tol == pytest.approx(0.5 / 5**0.5, rel=1e-6)


def test_two_triangles_of_a_saddle_leave_a_quarter():
    result = equimesh.remesh("x*y", target=2, domain=UNIT)
    assert result.tol == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize("source", ["3", "2*x - y", "1e9 + 0*x", np.zeros((5, 6))])
def test_what_is_plane_needs_two_triangles(source):
    domain = None if isinstance(source, np.ndarray) else UNIT
    result, runs = counted(source, domain, target=100)
    assert len(result.triangles) == 2
    assert result.status.ok
    assert runs == 1


def test_heights_in_other_units_give_the_same_mesh():
    one = equimesh.remesh(HARMONIC, target=150, domain=UNIT, effort="fast")
    other = equimesh.remesh(f"1024*{HARMONIC}", target=150, domain=UNIT, effort="fast")
    assert other.tol == pytest.approx(1024 * one.tol, rel=1e-6)
    np.testing.assert_array_equal(one.triangles, other.triangles)


@pytest.mark.parametrize("options", [{"target": 20}, {"tol": 0.1, "max_triangles": 20}])
def test_an_outline_that_takes_more_triangles_is_refused(options):
    disc = shapely.Point(0, 0).buffer(1, 16)
    with pytest.raises(InputError, match="62 triangles at least"):
        equimesh.remesh("x*y", domain=disc, **options)


def test_the_first_tolerance_of_a_saddle_follows_from_the_lower_bound():
    saddle = equimesh.as_field("x*y")
    box = shapely.box(0, 0, 3, 1)  # N* = 3 / (2 sqrt(5) tol)
    assert first_tolerance(saddle, box, 1000) == pytest.approx(1.08 * 1.5 / 5**0.5 / 1000)
    assert first_tolerance(saddle, box, 500) == pytest.approx(1.08 * 1.5 / 5**0.5 / 500)


def test_the_first_tolerance_of_data_is_near_that_of_the_smooth_surface_they_sample():
    x, y = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 101))
    smooth = equimesh.as_field(bowl, shapely.box(*UNIT))
    data = equimesh.Raster(bowl(x, y), transform=(1 / 200, 0, 0, 0, 1 / 100, 0))
    asked = first_tolerance(smooth, shapely.box(*UNIT), 500)
    assert 0.5 < first_tolerance(data, data.outline(0.0), 500) / asked < 2.5


def test_the_tolerance_comes_first():
    plain = equimesh.remesh(HARMONIC, 0.5, UNIT, effort="fast")
    result, runs = counted(HARMONIC, UNIT, tol=0.5, max_triangles=5000, effort="fast")
    assert result.status is Status.CONVERGED
    assert result.tol == 0.5
    assert result.notes == plain.notes
    assert runs == 1
    np.testing.assert_array_equal(result.points, plain.points)


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_the_number_of_triangles_comes_first(share):
    plain = equimesh.remesh(HARMONIC, 0.5, UNIT, effort="fast")
    most = int(share * len(plain.triangles))
    result, runs = counted(HARMONIC, UNIT, tol=0.5, max_triangles=most, effort="fast")
    assert result.status is Status.LIMITED
    assert result.status.usable
    assert not result.status.ok
    assert 0.97 * most <= len(result.triangles) <= most
    assert 0.5 < result.profile.bound <= result.tol
    assert result.tol == pytest.approx(0.5 / share, rel=0.3)
    assert f"{most} triangles ended the run" in result.notes[-1]
    assert runs <= RUNS


def test_a_share_of_the_range_and_a_number_of_triangles():
    heights = raster()
    result = equimesh.remesh(heights, "0.5%", max_triangles=100, effort="fast")
    assert result.status is Status.LIMITED
    assert 97 <= len(result.triangles) <= 100
    assert 0.005 * np.ptp(heights) < result.profile.bound <= result.tol


@pytest.mark.parametrize(
    "options",
    [
        {"target": 1},
        {"target": 2.5},
        {"target": "many"},
        {"target": True},
        {"max_triangles": 100},
        {"tol": 0.1, "max_triangles": 1},
        {"target": 10, "max_triangles": 10},
        {"source": equimesh.Metric.isotropic(0.1), "tol": 1.0, "max_triangles": 100},
    ],
)
def test_numbers_that_make_no_sense_are_refused_in_one_sentence(options):
    with pytest.raises(InputError) as caught:
        equimesh.remesh(**{"source": "x*y", "domain": UNIT, **options})
    assert str(caught.value).count("\n") == 0
    assert str(caught.value).endswith(".")


def run(*words):
    return CliRunner().invoke(cli.app, [str(word) for word in words], catch_exceptions=False)


FUNCTION = ("remesh", "--function", HARMONIC, "--domain", "0,0,1,1", "--effort", "fast")


def test_the_command_writes_its_files_and_says_that_the_triangles_ended_it(tmp_path):
    made, report = tmp_path / "a.npz", tmp_path / "r.json"
    done = run(*FUNCTION, made, "--tol", 0.5, "--max-triangles", 200, "--report", report)
    assert done.exit_code == 3
    assert "200 triangles ended the run" in " ".join(done.stdout.split())
    figures = json.loads(report.read_text())
    assert figures["status"] == "limited"
    assert figures["triangles"] <= 200
    assert 0.5 < figures["error_bound"] <= figures["tol"]
    assert len(np.load(made)["triangles"]) == figures["triangles"]


def test_the_command_succeeds_where_the_tolerance_comes_first(tmp_path):
    done = run(*FUNCTION, tmp_path / "a.npz", "--tol", 5, "--max-triangles", 2000)
    assert done.exit_code == 0, done.stderr
    assert "ended the run" not in done.stdout


def test_the_command_wants_a_tolerance_with_it(tmp_path):
    done = run(*FUNCTION, tmp_path / "a.npz", "--target", 100, "--max-triangles", 200)
    assert done.exit_code == 2


def test_bodies_share_the_triangles():
    one = surface()
    body = trimesh.Trimesh(one.points, one.triangles, process=False)
    both = trimesh.util.concatenate([body, body.copy().apply_translation((3, 0, 0))])
    made = remesh_trimesh(both, "0.1%", max_triangles=120, effort="fast")
    assert 80 <= len(made.faces) <= 120
