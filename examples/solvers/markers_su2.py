"""SU2: a channel around a body, written with its markers and read again by two other readers."""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path

import meshio
import numpy as np
import shapely

import equimesh
import equimesh_adapters
from equimesh_adapters.su2 import markers

__all__ = ["compare"]


def compare(folder: Path) -> dict[str, int]:
    """The number of edges of each marker, after all of them were found equal."""
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    body = shapely.Polygon(np.column_stack([0.5 * np.cos(angle), 0.3 * np.sin(angle)]))
    channel = shapely.box(-2.0, -1.5, 4.0, 1.5) - body
    result = equimesh.remesh("exp(-2*(x**2 + 2*y**2))", 0.01, channel)
    path = folder / "channel.su2"
    equimesh_adapters.save(path, result)

    boundary = result.boundary
    written = {name.replace(" ", "_"): boundary.edges_of(name) for name in boundary.names}
    found = markers(path.read_text(encoding="utf-8"))
    assert found.keys() == written.keys()
    assert all((found[name] == edges).all() for name, edges in written.items())
    mesh = equimesh_adapters.load_mesh(path)
    assert (mesh.points == result.points[:, :2]).all()
    assert (mesh.triangles == result.triangles).all()

    with contextlib.redirect_stderr(io.StringIO()):  # meshio remarks that it drops names:
        theirs = meshio.read(path)  # it numbers markers in their order, from 1
    assert (theirs.points == result.points[:, :2]).all()
    assert (theirs.get_cells_type("triangle") == result.triangles).all()
    tags = theirs.get_cell_data("su2:tag", "line")
    for number, edges in enumerate(written.values(), 1):
        assert (theirs.get_cells_type("line")[tags == number] == edges).all()
    return {name: len(edges) for name, edges in written.items()}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for name, count in compare(Path(folder)).items():
            print(f"{name}: {count} edges, equal in both readers")
