"""Pictures: what is drawn is what was measured."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from equimesh import plot
from equimesh.errors import InputError
from equimesh.profile import Profile


def grid(n, flat=False):
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.vstack(
        [np.column_stack([i, i + 1, i + n + 2]), np.column_stack([i, i + n + 2, i + n + 1])]
    )
    errors = np.zeros(len(triangles)) if flat else np.random.default_rng(3).random(len(triangles))
    return SimpleNamespace(
        points=np.column_stack([x, y, x * y]), triangles=triangles, errors=errors, max=errors.max()
    )


def test_the_error_profile_shows_the_errors_in_ascending_order():
    axes = Figure().subplots()
    profile = grid(7)
    plot.draw_profile(axes, profile.errors, 2.0)
    curve, level = axes.lines
    np.testing.assert_array_equal(curve.get_ydata(), np.sort(profile.errors))
    assert (np.diff(curve.get_xdata()) > 0).all()
    assert set(level.get_ydata()) == {2.0}


def test_a_profile_draws_itself_on_given_axes_or_its_own():
    mesh = grid(7)
    profile = Profile(mesh.errors, mesh.errors, mesh.points, mesh.triangles)
    axes = Figure().subplots()
    assert profile.plot(axes) is axes
    np.testing.assert_array_equal(profile.plot().lines[0].get_ydata(), axes.lines[0].get_ydata())


def test_every_triangle_has_the_colour_of_its_error():
    axes = Figure().subplots()
    profile = grid(7)
    drawn = plot.draw_mesh(axes, profile, 2.0)
    np.testing.assert_array_equal(drawn.get_array(), profile.errors)
    assert drawn.get_clim() == (0.0, 2.0)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_the_same_profile_gives_the_same_bytes(suffix, tmp_path):
    files = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for file in files:
        plot.save_plot(file, grid(7), 2.0)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_many_triangles_stay_a_small_picture(tmp_path):
    plot.save_plot(tmp_path / "a.pdf", grid(224), None)
    assert (tmp_path / "a.pdf").stat().st_size < 2_000_000


def test_a_mesh_without_error_can_be_drawn(tmp_path):
    plot.save_plot(tmp_path / "a.png", grid(1, flat=True), None)
    assert (tmp_path / "a.png").stat().st_size > 0


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"equimesh\[plot\]"):
        plot.save_plot(tmp_path / "a.png", grid(1), None)
