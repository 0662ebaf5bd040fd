"""Real solvers on our meshes: their answers converge to closed forms as they should.

A solver that is absent makes its test skip and say why; with ``EQUIMESH_SOLVERS=required`` in the
environment, as in CI, it makes the test fail.
"""

import importlib
import os
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.solvers

SCRIPTS = Path(__file__).parents[2] / "examples" / "solvers"
STUDIES = (
    "poisson_scikit_fem", "poisson_freefem", "poisson_dolfinx", "plate_calculix", "refine_gmsh",
)  # fmt: skip


@pytest.fixture
def script(monkeypatch):
    """The scripts' modules by name."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module


@pytest.mark.parametrize("name", STUDIES)
def test_answers_on_three_meshes_converge_at_second_order(name, script, tmp_path):
    absent = script("study").Absent
    try:
        study = script(name).study(tmp_path)
    except absent as reason:
        if os.environ.get("EQUIMESH_SOLVERS") == "required":
            pytest.fail(str(reason))
        pytest.skip(str(reason))
    assert len(study.triangles) == 3
    assert np.diff(study.triangles).min() > 0
    assert study.rate == pytest.approx(2.0, abs=0.2), study


def test_markers_of_su2_come_back_by_name(script, tmp_path):
    sides = script("markers_su2").compare(tmp_path)
    assert sides.keys() == {"outline", "hole_1"}
    assert sides["hole_1"] >= 48


def test_a_rate_is_the_slope_over_h(script):
    study = script("study").Study("", (100, 400, 1600), (1.0, 0.25, 0.0625))
    assert study.rate == pytest.approx(2.0, abs=1e-12)
    study = script("study").Study("", (100, 400, 1600), (1.0, 0.5, 0.25))
    assert study.rate == pytest.approx(1.0, abs=1e-12)


def test_a_program_that_is_absent_is_named_with_its_package(script, tmp_path):
    study = script("study")
    with pytest.raises(study.Absent, match="no-such-solver is not installed: apt-get install it"):
        study.run("it", "no-such-solver", cwd=tmp_path)


def test_the_plate_is_free_of_load_at_its_hole_and_stretched_far_away(script):
    """Kirsch's displacements, differentiated: stresses by Hooke's law in plane stress."""
    plate = script("plate_calculix")

    def stress(x, y, h=1e-5):
        ux, vx = ((plate.kirsch(x + h, y) - plate.kirsch(x - h, y)) / (2 * h)).T
        uy, vy = ((plate.kirsch(x, y + h) - plate.kirsch(x, y - h)) / (2 * h)).T
        e, nu = plate.YOUNG, plate.POISSON
        along, across = e / (1 - nu**2) * np.array([ux + nu * vy, vy + nu * ux])
        return along, across, e / (2 * (1 + nu)) * (uy + vx)

    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    cos, sin = np.cos(angle), np.sin(angle)
    along, across, shear = stress(cos, sin)
    assert np.abs(along * cos + shear * sin).max() < 1e-8
    assert np.abs(shear * cos + across * sin).max() < 1e-8
    assert along.max() == pytest.approx(3.0, abs=1e-8)
    assert np.array(stress(np.array([1e4]), np.array([2e4]))).ravel() == pytest.approx(
        [1.0, 0.0, 0.0], abs=1e-6
    )
