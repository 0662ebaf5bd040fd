"""Gmsh: a mesh opened again and refined twice, its groups intact, and a surface's error by four.

The surface is a known function. Gmsh reads the mesh of its plane domain, halves all triangles'
sides, and integrates by its own quadrature how far linear interpolation on its nodes is from the
function.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from study import Absent, Study, show

import equimesh
import equimesh_adapters

__all__ = ["study"]

SURFACE = "exp(2*x)*sin(3*y)"


def study(folder: Path) -> Study:
    """L2 errors of interpolation on the mesh as opened, refined once, and refined twice."""
    try:
        import gmsh
    except (ImportError, OSError) as reason:
        raise Absent(f"Gmsh cannot be loaded ({reason}): pip install 'equimesh[gmsh]'") from None

    result = equimesh.remesh(SURFACE, 0.02, (0, 0, 1, 1))
    path = folder / "square.msh"
    equimesh_adapters.save(path, result)
    counts, errors = [], []
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.logger.start()
        gmsh.open(str(path))
        for view in gmsh.view.getTags():  # errors of triangles that refinement will replace
            gmsh.view.remove(view)
        groups = _groups(gmsh)
        assert set(result.boundary.names) <= {name for _, name in groups}
        for step in range(3):
            if step:
                gmsh.model.mesh.refine()
                assert _groups(gmsh).keys() == groups.keys()
            for (dimension, name), size in groups.items():
                assert abs(_groups(gmsh)[dimension, name] - size) <= 1e-9, name
            counts.append(len(gmsh.model.mesh.getElementsByType(2)[0]))
            errors.append(_error(gmsh))
        complaints = [line for line in gmsh.logger.get() if line.startswith(("Warning", "Error"))]
        assert not complaints, complaints
    finally:
        gmsh.logger.stop()
        gmsh.finalize()
    return Study("Gmsh: opened, refined, refined; L2 error", tuple(counts), tuple(errors))


def _exact(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.exp(2.0 * x) * np.sin(3.0 * y)


def _groups(gmsh) -> dict[tuple[int, str], float]:
    """The length or the area, in the plane, of every named group by its dimension and name."""
    where = _nodes(gmsh)
    sizes = {}
    for dimension, tag in gmsh.model.getPhysicalGroups():
        total = 0.0
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            _, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
            corners = where[np.concatenate(nodes).astype(int)].reshape(-1, dimension + 1, 2)
            steps = corners[:, 1:] - corners[:, :1]
            if dimension == 1:
                total += float(np.linalg.norm(steps[:, 0], axis=1).sum())
            else:
                total += float(0.5 * np.abs(np.linalg.det(steps)).sum())
        sizes[dimension, gmsh.model.getPhysicalName(dimension, tag)] = total
    return sizes


def _nodes(gmsh) -> np.ndarray:
    """(n + 1, 2) coordinates in the plane by node number."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    where = np.zeros((int(tags.max()) + 1, 2))
    where[tags.astype(int)] = coordinates.reshape(-1, 3)[:, :2]
    return where


def _error(gmsh) -> float:
    """The L2 distance over the plane of the function and its linear interpolant."""
    triangle = 2
    corners = _nodes(gmsh)[gmsh.model.mesh.getElementsByType(triangle)[1].astype(int)]
    corners = corners.reshape(-1, 3, 2)
    places, weights = gmsh.model.mesh.getIntegrationPoints(triangle, "Gauss6")
    _, shapes, _ = gmsh.model.mesh.getBasisFunctions(triangle, places, "Lagrange1")
    shapes = shapes.reshape(-1, 3)  # of each place, the shares of the corners
    there = np.einsum("pk,mkd->mpd", shapes, corners)
    heights = _exact(corners[..., 0], corners[..., 1]) @ shapes.T
    off = heights - _exact(there[..., 0], there[..., 1])
    twice_area = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return float(np.sqrt(twice_area @ (off**2 @ weights)))


if __name__ == "__main__":
    show(study)
