"""The command line: figures on stdout, files that appear together, one sentence for bad input."""

import functools
import json
import pickle
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from matplotlib import get_data_path
from typer.testing import CliRunner

import equimesh
from equimesh import cli, formats, paper

JACKSBORO = Path(get_data_path()) / "sample_data" / "jacksboro_fault_dem.npz"
KEYS = {
    "status", "tol", "triangles", "vertices", "max_error", "error_bound", "quantiles",
    "lower_bound", "efficiency", "seed", "seconds", "version", "bound", "smallest_angles",
    "norm",
}  # fmt: skip


@pytest.fixture
def room(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words):
    return CliRunner().invoke(cli.app, [str(word) for word in words], catch_exceptions=False)


def strict_json(path):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(Path(path).read_text(), parse_constant=refuse)


def area(points, triangles):
    a, b, c = (points[triangles[:, k], :2] for k in range(3))
    return 0.5 * np.sum((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def grid_triangles(n):
    """(2 (n - 1)^2, 3) triangles on n x n points, row by row."""
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower, upper = np.column_stack([i, i + 1, i + n]), np.column_stack([i + 1, i + n + 1, i + n])
    return np.vstack([lower, upper])


def dense_error(points, triangles, f, n=24):
    """Largest |f - linear| at (n + 1)(n + 2) / 2 points of every triangle."""
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    weights = np.stack([i, j, n - i - j]) / n
    x, y, z = np.einsum("kp,mkc->cmp", weights, points[triangles])
    return np.abs(f(x, y) - z).max()


# What it does


def test_a_function_becomes_a_mesh_within_its_tolerance(room):
    done = run(
        "remesh", "--function", "exp(2*x)*sin(3*y)", "--domain", "0,0,1,2", "a.npz",
        "--tol", "0.05", "--report", "r.json", "--plot", "p.png",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""
    points, triangles = formats.load_mesh("a.npz")
    error = dense_error(points, triangles, lambda x, y: np.exp(2 * x) * np.sin(3 * y))
    report = strict_json("r.json")
    assert error <= report["error_bound"] <= 0.05
    assert area(points, triangles) == pytest.approx(2.0, rel=1e-9)
    assert set(report) == KEYS
    assert report["triangles"] == len(triangles)
    assert report["vertices"] == len(points)
    assert report["status"] == "converged"
    assert report["efficiency"] == pytest.approx(report["lower_bound"] / len(triangles))
    ascending = list(report["quantiles"].values())
    assert ascending == sorted(ascending)
    assert ascending[-1] == report["max_error"]
    assert min(report["seconds"].values()) >= 0
    assert Path("p.png").read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in room.iterdir()} == {"a.npz", "r.json", "p.png"}


def test_the_table_has_the_figures_of_the_report(room):
    done = run(
        "remesh", "--function", "x*y", "--domain", "0,0,1,1", "a.ply", "--tol", "0.01",
        "--report", "r.json",
    )  # fmt: skip
    rows = dict(re.split(r"  +", line.strip(), maxsplit=1) for line in done.stdout.splitlines())
    report = strict_json("r.json")
    assert rows["triangles"] == f"{report['triangles']:,}"
    assert float(rows["largest error"]) == pytest.approx(report["max_error"], rel=1e-5)
    assert float(rows["bound on the error"]) == pytest.approx(report["error_bound"], rel=1e-5)
    assert float(rows["efficiency N*/N"]) == pytest.approx(report["efficiency"], abs=1e-3)
    assert rows["tolerance"] == "0.01"
    assert "input" in rows
    assert any(row.startswith("seconds, ") for row in rows)


@pytest.mark.parametrize("text", ["0*x", "3", "2*x - 5*y + 7"])
def test_a_plane_over_a_rectangle_is_two_triangles(text, room):
    done = run("remesh", "--function", text, "--domain", "0,0,3,1", "a.npz", "--tol", "0.1")
    assert done.exit_code == 0, done.stderr
    points, triangles = formats.load_mesh("a.npz")
    assert len(triangles) == 2
    assert area(points, triangles) == pytest.approx(3.0, rel=1e-12)


def test_a_plane_with_a_tolerance_in_percent_is_two_triangles(room):
    done = run("remesh", "--function", "x + y", "--domain", "0,0,1,1", "a.npz", "--tol", "1%")
    assert done.exit_code == 0, done.stderr
    assert len(formats.load_mesh("a.npz").triangles) == 2


def test_domains_are_boxes_wkt_or_geojson_and_keep_their_holes(room):
    ring = shapely.box(0, 0, 4, 3).difference(shapely.box(1, 1, 2, 2))
    feature = {
        "type": "Feature",
        "properties": {},
        "geometry": json.loads(shapely.to_geojson(ring)),
    }
    collection = {"type": "FeatureCollection", "features": [feature]}
    Path("feature.geojson").write_text(json.dumps(feature))
    Path("collection.json").write_text(json.dumps(collection))
    Path("geometry.geojson").write_text(shapely.to_geojson(ring))
    found = []
    for domain in (ring.wkt, "feature.geojson", "collection.json", "geometry.geojson"):
        done = run("remesh", "--function", "x*y", "--domain", domain, "a.npz", "--tol", "0.1")
        assert done.exit_code == 0, done.stderr
        found.append(formats.load_mesh("a.npz"))
        assert area(*found[-1]) == pytest.approx(11.0, rel=1e-9)
    for mesh in found[1:]:
        np.testing.assert_array_equal(mesh.points, found[0].points)
        np.testing.assert_array_equal(mesh.triangles, found[0].triangles)


def test_the_same_seed_gives_the_same_bytes(room):
    for name in ("a", "b"):
        run(
            "remesh", "--function", "sin(3*x*y)", "--domain", "0,0,1,1", f"{name}.ply",
            "--tol", "0.01", "--plot", f"{name}.png", "--seed", "5",
        )  # fmt: skip
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes()
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()


def test_a_target_of_triangles_is_not_exceeded_by_much(room):
    done = run(
        "remesh",
        "--function",
        "exp(2*x)*sin(3*y)",
        "--domain",
        "0,0,1,1",
        "a.npz",
        "--target",
        "300",
    )
    assert done.exit_code == 0, done.stderr
    assert 150 <= len(formats.load_mesh("a.npz").triangles) <= 360


def test_terrain_from_the_file_that_ships_with_matplotlib(room):
    done = run("remesh", JACKSBORO, "a.ply", "--tol", "5%", "--report", "r.json", "--plot", "p.png")
    assert done.exit_code == 0, done.stderr
    elevation = np.load(JACKSBORO)["elevation"]
    report = strict_json("r.json")
    assert report["tol"] == pytest.approx(0.05 * np.ptp(elevation))
    assert report["error_bound"] <= report["tol"]
    assert "344 x 403 samples" in done.stdout
    points, triangles = formats.load_mesh("a.ply")
    rows, columns = elevation.shape
    assert area(points, triangles) == pytest.approx((rows - 1) * (columns - 1), rel=1e-12)


def test_a_surface_keeps_its_own_coordinates_whatever_is_up(room):
    n = 30
    u, v = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n)]))
    height = 0.3 * np.sin(3 * u) * v
    # A graph over y and z: seen along z it folds.
    points = np.column_stack([height, u, v])
    trimesh.Trimesh(points, grid_triangles(n), process=False).export("wall.off")
    for up in (["--up", "x"], ["--up", "1,0,0"]):
        done = run("remesh", "wall.off", "a.npz", "--tol", "0.01", *up)
        assert done.exit_code == 0, done.stderr
        found = formats.load_mesh("a.npz").points
        assert found[:, 1].min() == pytest.approx(0.0, abs=1e-12)
        assert found[:, 1].max() == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(
            found[:, 0], 0.3 * np.sin(3 * found[:, 1]) * found[:, 2], atol=0.011
        )
        checked = run("profile", "a.npz", "--against", "wall.off", "--report", "r.json", *up)
        assert checked.exit_code == 0, checked.stderr
        assert strict_json("r.json")["error_bound"] <= 0.01 * (1 + 1e-9)


def test_what_was_mended_in_a_surface_is_said(room):
    points, triangles = wave()
    twice = np.vstack([triangles, triangles[:3, [0, 2, 1]]])
    np.savez("in.npz", points=np.vstack([points, points[:1]]), triangles=twice)
    done = run("remesh", "in.npz", "a.npz", "--tol", "5%")
    assert done.exit_code == 0, done.stderr
    assert "twice" in done.stdout
    assert area(*formats.load_mesh("a.npz")) == pytest.approx(1.0, rel=1e-9)


def test_profile_measures_a_mesh_from_elsewhere(room):
    # Two triangles on x y over the unit square: the error is 1/4 on the diagonal.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0.0]])
    np.savez("square.npz", points=points, triangles=[[0, 1, 2], [0, 2, 3]])
    done = run(
        "profile", "square.npz", "--function", "x*y", "--report", "r.json", "--plot", "p.pdf"
    )
    assert done.exit_code == 0, done.stderr
    report = strict_json("r.json")
    assert report["max_error"] == pytest.approx(0.25, rel=1e-9)
    assert 0.25 <= report["error_bound"] <= 0.25 * 1.05
    assert set(report) == {
        "triangles", "vertices", "max_error", "error_bound", "quantiles", "seconds", "version",
        "bound", "smallest_angles",
    }  # fmt: skip
    assert Path("p.pdf").read_bytes().startswith(b"%PDF")


def test_bound_says_where_errors_of_a_raster_count(room):
    heights = np.random.default_rng(0).normal(size=(30, 40))
    np.save("rough.npy", heights)
    found = {}
    for bound in ("surface", "samples"):
        words = ("rough.npy", f"{bound}.npz", "--tol", "20%", "--bound", bound)
        done = run("remesh", *words, "--report", "r.json")
        assert done.exit_code == 0, done.stderr
        assert ("at samples" in done.stdout) == (bound == "samples")
        found[bound] = strict_json("r.json")
        assert found[bound]["bound"] == bound
        mesh = np.load(f"{bound}.npz")
        measured = equimesh.profile(mesh["points"], mesh["triangles"], heights, bound)
        assert measured.bound <= found[bound]["tol"]
    assert "between them" in done.stdout.replace("\n", " ")
    assert found["samples"]["triangles"] < found["surface"]["triangles"]
    refused = run("remesh", "--function", "x*y", "--domain", "0,0,1,1", "o.npz", "--tol", "1%",
                  "--bound", "samples")  # fmt: skip
    assert refused.exit_code == 1
    assert "rasters only" in refused.stderr


def test_fill_holes_closes_those_of_a_surface(room):
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    cell = np.arange(81).reshape(9, 9)
    a, b, c, d = (k.ravel() for k in (cell[:-1, :-1], cell[:-1, 1:], cell[1:, 1:], cell[1:, :-1]))
    triangles = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    middle = np.stack([x, y], 1)[triangles].mean(axis=1)
    triangles = triangles[np.abs(middle - 4.0).max(axis=1) > 1.0]
    np.savez("scan.npz", points=np.column_stack([x, y, x + 2 * y]), triangles=triangles)
    counts = []
    for words in ([], ["--fill-holes", "8 edges"], ["--fill-holes", "3.9"], ["--fill-holes", "4"]):
        done = run("remesh", "scan.npz", "out.npz", "--tol", "1%", *words)
        assert done.exit_code == 0, done.stderr
        assert ("closed 1 hole" in done.stdout) == (words[1:] in (["8 edges"], ["4"]))
        counts.append(len(np.load("out.npz")["triangles"]))
    assert counts[0] == counts[2] == 8
    assert counts[1] == counts[3] == 2
    np.save("flat.npy", np.zeros((3, 3)))
    done = run("remesh", "flat.npy", "out.npz", "--tol", "1", "--fill-holes", "all")
    assert done.exit_code == 1
    assert "surfaces" in done.stderr


def test_profile_takes_the_heights_of_a_flat_mesh_from_the_surface(room):
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    for flat in (points, np.column_stack([points, np.zeros(4)])):
        np.savez("square.npz", points=flat, triangles=[[0, 1, 2], [0, 2, 3]])
        run("profile", "square.npz", "--function", "x*y + 5", "--report", "r.json")
        assert strict_json("r.json")["max_error"] == pytest.approx(0.25, rel=1e-9)


def test_a_bar_is_drawn_on_stderr_for_someone_who_watches(room, monkeypatch):
    words = ["--function", "x*y", "--domain", "0,0,1,1", "a.ply", "--tol", "0.01"]
    unwatched = run("remesh", *words)
    assert unwatched.stderr == ""
    monkeypatch.setattr(cli, "Console", functools.partial(cli.Console, force_terminal=True))
    watched = run("remesh", *words)
    assert watched.exit_code == 0
    assert "\x1b[" in watched.stderr


def test_version_and_help(room):
    assert run("--version").stdout.strip() == cli.report.installed_version()
    assert "remesh" in run("--help").stdout
    assert run().exit_code == 2


def test_paper_runs_the_program_beside_the_package_in_the_folder_that_was_named(room, monkeypatch):
    program = room / "examples" / "paper"
    program.mkdir(parents=True)
    (program / "other.py").write_text("WORD = 'made'")
    (program / "__main__.py").write_text(
        "import sys, pathlib, other\npathlib.Path(sys.argv[1]).write_text(other.WORD)\n"
    )
    monkeypatch.setattr("equimesh.paper.__file__", str(room / "paper.py"))
    before = list(sys.argv)
    done = run("paper", "page")
    assert done.exit_code == 0, done.stderr
    assert Path("page").read_text() == "made"
    assert sys.argv == before


def test_the_program_of_the_paper_is_in_the_checkout():
    assert paper.program().joinpath("__main__.py").is_file()


# Bad input: one sentence, exit status 1, no file


def wave(n=6):
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n)]))
    return np.column_stack([x, y, np.sin(3 * x) * y]), grid_triangles(n)


def array(heights):
    return lambda: np.save("in.npy", np.asarray(heights))


def mesh(points, triangles):
    return lambda: np.savez("in.npz", points=points, triangles=triangles)


def truncated_ply():
    trimesh.Trimesh(*wave(), process=False).export("in.ply")
    Path("in.ply").write_bytes(Path("in.ply").read_bytes()[:-200])


class Bomb:
    def __reduce__(self):
        return open, ("boom", "w")


def pickled():
    np.savez("in.npz", a=np.array([[Bomb()]], dtype=object))


def bare_pickle():
    Path("in.npz").write_bytes(pickle.dumps(Bomb()))


def lines_only():
    import meshio

    meshio.write("in.vtu", meshio.Mesh(np.eye(3), [("line", np.array([[0, 1]]))]))


def nothing():
    pass


POINTS, TRIANGLES = wave()
SPHERE = trimesh.creation.icosphere(2)
NAN, HOLED = np.full((5, 5), np.nan), np.eye(5)
SPIKED = np.where(np.eye(6) > 0, np.inf, 1.0)
BOOK = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [1, 0, 1.0]])
PAGES = [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
EXPRESSION = ["--domain", "0,0,1,1", "out.ply", "--tol", "0.1", "--function"]
ON_X = ["--function", "x*y", "out.ply", "--tol", "0.1", "--domain"]

BAD = {
    "all samples NaN": (array(NAN), ["in.npy", "out.ply", "--tol", "1%"]),
    "an infinite sample": (array(SPIKED), ["in.npy", "out.ply", "--tol", "1%"]),
    "no samples": (array(np.empty((0, 0))), ["in.npy", "out.ply", "--tol", "1%"]),
    "one sample": (array([[1.0]]), ["in.npy", "out.ply", "--tol", "1%"]),
    "one row": (array([[1.0, 2.0, 3.0]]), ["in.npy", "out.ply", "--tol", "1%"]),
    "a cube of samples": (array(np.zeros((3, 3, 3))), ["in.npy", "out.ply", "--tol", "1%"]),
    "samples that are words": (array([["a", "b"]]), ["in.npy", "out.ply", "--tol", "1%"]),
    "complex samples": (array(1j * HOLED), ["in.npy", "out.ply", "--tol", "1%"]),
    "tolerance zero": (array(HOLED), ["in.npy", "out.ply", "--tol", "0"]),
    "tolerance negative": (array(HOLED), ["in.npy", "out.ply", "--tol", "-1"]),
    "tolerance zero percent": (array(HOLED), ["in.npy", "out.ply", "--tol", "0%"]),
    "tolerance abc%": (array(HOLED), ["in.npy", "out.ply", "--tol", "abc%"]),
    "tolerance nan": (array(HOLED), ["in.npy", "out.ply", "--tol", "nan"]),
    "tolerance infinite": (array(HOLED), ["in.npy", "out.ply", "--tol", "inf"]),
    "tolerance empty": (array(HOLED), ["in.npy", "out.ply", "--tol", ""]),
    "missing file": (nothing, ["in.npy", "out.ply", "--tol", "1%"]),
    "folder as input": (lambda: Path("in.npy").mkdir(), ["in.npy", "out.ply", "--tol", "1%"]),
    "empty file": (lambda: Path("in.ply").touch(), ["in.ply", "out.ply", "--tol", "1%"]),
    "input of no kind": (lambda: Path("in.xyz").touch(), ["in.xyz", "out.ply", "--tol", "1%"]),
    "output of no kind": (array(HOLED), ["in.npy", "out.docx", "--tol", "1%"]),
    "output without a suffix": (array(HOLED), ["in.npy", "out", "--tol", "1%"]),
    "output that is only read": (array(HOLED), ["in.npy", "out.tif", "--tol", "1%"]),
    "output onto the input": (mesh(*wave()), ["in.npz", "in.npz", "--tol", "1%"]),
    "output in a missing folder": (array(HOLED), ["in.npy", "none/out.ply", "--tol", "1%"]),
    "output under a file": (array(HOLED), ["in.npy", "in.npy/out.ply", "--tol", "1%"]),
    "report in a missing folder": (
        array(HOLED), ["in.npy", "out.ply", "--tol", "1%", "--report", "none/r.json"],
    ),
    "plot of no kind": (array(HOLED), ["in.npy", "out.ply", "--tol", "1%", "--plot", "p.xls"]),
    "plot onto the output": (array(HOLED), ["in.npy", "p.ply", "--tol", "1%", "--report", "p.ply"]),
    "truncated ply": (truncated_ply, ["in.ply", "out.ply", "--tol", "1%"]),
    "pickled npz": (pickled, ["in.npz", "out.ply", "--tol", "1%"]),
    "bare pickle": (bare_pickle, ["in.npz", "out.ply", "--tol", "1%"]),
    "only lines": (lines_only, ["in.vtu", "out.ply", "--tol", "1%"]),
    "a closed surface": (mesh(SPHERE.vertices, SPHERE.faces), ["in.npz", "out.ply", "--tol", "1%"]),
    "a mesh with NaN": (mesh(POINTS * np.nan, TRIANGLES), ["in.npz", "out.ply", "--tol", "1%"]),
    "a vertex out of range": (mesh(POINTS[:9], TRIANGLES), ["in.npz", "out.ply", "--tol", "1%"]),
    "three triangles on an edge": (mesh(BOOK, PAGES), ["in.npz", "out.ply", "--tol", "1%"]),
    "all points the same": (mesh(0 * POINTS, TRIANGLES), ["in.npz", "out.ply", "--tol", "1%"]),
    "up without a direction": (
        mesh(*wave()), ["in.npz", "out.ply", "--tol", "1%", "--up", "sideways"],
    ),
    "up of length zero": (mesh(*wave()), ["in.npz", "out.ply", "--tol", "1%", "--up", "0,0,0"]),
    "up for a raster": (array(HOLED), ["in.npy", "out.ply", "--tol", "1%", "--up", "z"]),
    "up for a function": (nothing, [*EXPRESSION, "x*y", "--up", "z"]),
    "an expression that is a program": (nothing, [*EXPRESSION, "__import__('os').mkdir('boom')"]),
    "an expression that opens a file": (nothing, [*EXPRESSION, "open('boom', 'w')"]),
    "an expression with a foreign name": (nothing, [*EXPRESSION, "x*z"]),
    "an expression that does not end": (nothing, [*EXPRESSION, "sin(x"]),
    "an empty expression": (nothing, [*EXPRESSION, ""]),
    "a tower of exponents": (nothing, [*EXPRESSION, "9**9**9**9"]),
    "a huge exponent": (nothing, [*EXPRESSION, "x**999999999"]),
    "an endless expression": (nothing, [*EXPRESSION, "x" + "+x" * 40_000]),
    "a function without values": (nothing, [*EXPRESSION, "log(-1 - x)"]),
    "a function with a pole": (nothing, [*EXPRESSION, "1/(x - 0.5)"]),
    "no domain": (nothing, ["--function", "x*y", "out.ply", "--tol", "0.1"]),
    "domain of three numbers": (nothing, [*ON_X, "0,0,1"]),
    "domain without area": (nothing, [*ON_X, "0,0,1,0"]),
    "domain upside down": (nothing, [*ON_X, "1,1,0,0"]),
    "domain that is infinite": (nothing, [*ON_X, "0,0,inf,1"]),
    "domain that is nothing": (nothing, [*ON_X, "somewhere"]),
    "domain that is a line": (nothing, [*ON_X, "LINESTRING (0 0, 1 1)"]),
    "domain that is empty": (nothing, [*ON_X, "POLYGON EMPTY"]),
    "domain that crosses itself": (nothing, [*ON_X, "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"]),
    "domain with its hole outside": (
        nothing, [*ON_X, "POLYGON ((0 0, 1 0, 1 1, 0 1, 0 0), (2 2, 3 2, 3 3, 2 3, 2 2))"],
    ),
    "domain file that is missing": (nothing, [*ON_X, "none.geojson"]),
    "domain file that is none": (
        lambda: Path("in.geojson").write_text("{]"), [*ON_X, "in.geojson"],
    ),
    "domain off the raster": (
        array(HOLED), ["in.npy", "out.ply", "--tol", "1%", "--domain", "90,90,99,99"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_bad_input_is_one_sentence_and_leaves_nothing(kind, room):
    prepare, words = BAD[kind]
    prepare()
    before = {path: path.is_dir() or path.read_bytes() for path in room.iterdir()}
    done = run("remesh", *words)
    assert done.exit_code == 1
    assert done.stdout == ""
    sentence = done.stderr.rstrip("\n")
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert "Traceback" not in sentence
    assert {path: path.is_dir() or path.read_bytes() for path in room.iterdir()} == before


@pytest.mark.parametrize(
    "words",
    [
        ["profile", "none.ply", "--function", "x"],
        ["profile", "in.npy", "--function", "x"],
        ["profile", "in.npz", "--against", "none.tif"],
        ["profile", "in.npz", "--function", "open('boom')"],
        ["profile", "in.npz", "--function", "x", "--report", "none/r.json"],
        ["profile", "in.npz", "--function", "x", "--plot", "p.xls"],
        ["profile", "in.npz", "--function", "x", "--report", "in.npz"],
    ],
)
def test_bad_input_to_profile_is_one_sentence_and_leaves_nothing(words, room):
    mesh(*wave())()
    array(HOLED)()
    before = sorted(room.iterdir())
    done = run(*words)
    assert done.exit_code == 1
    assert done.stderr.endswith(".\n")
    assert done.stderr.count("\n") == 1
    assert sorted(room.iterdir()) == before


@pytest.mark.parametrize(
    "words",
    [
        ["remesh"],
        ["remesh", "a.ply", "--tol", "1"],
        ["remesh", "a.ply", "b.ply", "c.ply", "--tol", "1"],
        ["remesh", "a.ply", "b.ply"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--target", "9"],
        ["remesh", "a.ply", "b.ply", "--target", "0"],
        ["remesh", "a.ply", "b.ply", "--target", "few"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--function", "x"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--fit", "tight"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--effort", "none"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--seed", "x"],
        ["remesh", "a.ply", "b.ply", "--tol", "1", "--sideways"],
        ["profile"],
        ["profile", "a.ply"],
        ["profile", "a.ply", "--against", "b.ply", "--function", "x"],
        ["rename", "a.ply", "b.ply"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_exit_status_two(words, room):
    done = run(*words)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert "Usage" in done.stderr
    assert not list(room.iterdir())


@pytest.mark.parametrize(
    "trouble",
    [MemoryError(), KeyboardInterrupt(), equimesh.errors.Cancelled(), OSError(28, "No space left")],
    ids=lambda trouble: type(trouble).__name__,
)
def test_trouble_on_the_way_is_one_sentence_and_leaves_nothing(trouble, room, monkeypatch):
    def fail(*args, **options):
        raise trouble

    monkeypatch.setattr(equimesh, "remesh", fail)
    done = run("remesh", "--function", "x", "--domain", "0,0,1,1", "a.ply", "--tol", "1")
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert not list(room.iterdir())


def test_a_failure_while_drawing_leaves_no_mesh(room, monkeypatch):
    def fail(*args):
        raise OSError(28, "No space left")

    monkeypatch.setattr(cli.plot, "save_plot", fail)
    Path("a.ply").write_text("old")
    done = run(
        "remesh", "--function", "x", "--domain", "0,0,1,1", "a.ply", "--tol", "1",
        "--plot", "p.png", "--report", "r.json",
    )  # fmt: skip
    assert done.exit_code == 1
    assert [path.name for path in room.iterdir()] == ["a.ply"]
    assert Path("a.ply").read_text() == "old"


@pytest.mark.parametrize("lost", ["skfem", "matplotlib"])
def test_paper_names_the_extra_that_is_missing(lost, room, monkeypatch):
    monkeypatch.setattr(paper, "find_spec", lambda name: None if name == lost else object())
    done = run("paper", "page")
    assert done.exit_code == 1
    assert "equimesh[paper]" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(room.iterdir())


def test_paper_does_not_overwrite_a_file_with_its_folder(room):
    Path("page").write_text("mine")
    done = run("paper", "page")
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert Path("page").read_text() == "mine"


def test_the_program_itself_says_one_sentence_and_no_traceback(room):
    done = subprocess.run(
        [sys.executable, "-m", "equimesh", "remesh", "in.npy", "out.ply", "--tol", "1%"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "There is no file in.npy: check the name.\n"


SLOW = """
import signal, sys, time, equimesh
from equimesh.cli import main

# A shell that runs the tests in the background has its programs ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

def remesh(*args, **options):
    print("ready", flush=True)
    time.sleep(60)

equimesh.remesh = remesh
sys.argv = ["equimesh", "remesh", "--function", "x", "--domain", "0,0,1,1", "a.ply", "--tol", "1"]
main()
"""


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_a_polite_kill_leave_nothing(kind, room):
    program = subprocess.Popen(
        [sys.executable, "-c", SLOW], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert program.stdout.readline() == "ready\n"
        program.send_signal(kind)
        _, errors = program.communicate(timeout=30)
    finally:
        program.kill()
    assert program.returncode == 1
    assert errors == "Interrupted: nothing was written.\n"
    assert not list(room.iterdir())
