"""Gmsh's views: scalars as surfaces, and tensors for its mesher."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh_adapters.gmsh_model import opened, surface_mesh
from equimesh_adapters.tensors import pack

__all__ = ["add_tensors", "view_surface"]


def view_surface(view: int) -> Surface:
    """A Gmsh view with a scalar on triangles or quadrilaterals as a surface over x and y."""
    gmsh = opened()
    if view not in gmsh.view.getTags():
        raise InputError(f"Gmsh has no view {view}: its views are {list(gmsh.view.getTags())}.")
    lists = _asked(gmsh, gmsh.view.getListData, view)
    if lists is None:
        return _model_view(gmsh, view)
    points, triangles = [], []
    for kind, count, data in zip(*lists, strict=True):
        corners = {"ST": 3, "SQ": 4}.get(kind)
        if corners is None:
            continue
        rows = np.asarray(data).reshape(count, -1)[:, : 4 * corners]  # the first step
        xyz = rows[:, : 3 * corners].reshape(count, 3, corners).transpose(0, 2, 1).copy()
        xyz[:, :, 2] = rows[:, 3 * corners :]
        first = sum(map(len, points)) + corners * np.arange(count)[:, None]
        points.append(xyz.reshape(-1, 3))
        halves = np.array([[0, 1, 2], [0, 2, 3]][: corners - 2])
        triangles.append((first[:, None] + halves).reshape(-1, 3))
    if not points:
        raise _unfit(view)
    return Surface(np.concatenate(points), np.concatenate(triangles), up="z")


def _model_view(gmsh: Any, view: int) -> Surface:
    data = _asked(gmsh, gmsh.view.getHomogeneousModelData, view, 0)
    if data is None:
        raise _unfit(view)
    kind, numbers, values, _, components = data
    if kind != "NodeData" or components != 1:
        raise _unfit(view)
    numbers = np.asarray(numbers, np.int64)
    order = np.argsort(numbers)
    value = np.asarray(values, float)[order]
    known, coordinates, _ = gmsh.model.mesh.getNodes()
    points = np.asarray(coordinates).reshape(-1, 3)
    lift = {tuple(p): int(n) for p, n in zip(points.tolist(), known, strict=True)}
    places, triangles = surface_mesh(gmsh, None)
    wanted = np.array([lift[tuple(p)] for p in places.tolist()])
    rows = np.minimum(np.searchsorted(numbers[order], wanted), len(numbers) - 1)
    there = numbers[order][rows] == wanted
    heights = np.where(there, value[rows], 0.0)
    return Surface(
        np.column_stack([places[:, :2], heights]), triangles[there[triangles].all(axis=1)], up="z"
    )


def _asked(gmsh: Any, question: Callable[..., Any], *about: Any) -> Any:
    """What Gmsh answers, or None where it refuses: it has no other way to tell kinds of views."""
    loudness = gmsh.option.getNumber("General.Verbosity")
    gmsh.option.setNumber("General.Verbosity", 0)
    try:
        return question(*about)
    except Exception:  # noqa: BLE001, Gmsh raises nothing narrower
        return None
    finally:
        gmsh.option.setNumber("General.Verbosity", loudness)


def _unfit(view: int) -> InputError:
    return InputError(
        f"View {view} has no scalar at nodes of triangles: give one of kind NodeData, or a list of "
        "scalar triangles."
    )


def add_tensors(
    gmsh: Any,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tensors: NDArray[np.float64],
    height: float,
) -> int:
    """Add a list-based view of tensors (n, 2, 2), linear on triangles at one height; its tag.

    For each triangle three x, three y, three z of its corners, then nine entries at each corner.
    """
    space = np.column_stack([points, np.full(len(points), height)])
    places = np.concatenate([space[triangles], _anchors(space)])
    entries = pack(tensors, "rows")[np.concatenate([triangles, np.zeros((2, 3), np.int64)])]
    data = np.hstack([places.transpose(0, 2, 1).reshape(-1, 9), entries.reshape(-1, 27)])
    view = gmsh.view.add("equimesh metric")
    gmsh.view.addListData(view, "TT", len(data), data.ravel())
    return int(view)


def _anchors(space: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 3, 3) two small triangles beyond opposite corners of a mesh.

    Gmsh halves a view's box again and again to find triangles. Where a triangle's middle falls on a
    dividing plane it may, by rounding, belong to neither half, and Gmsh (4.15) then ends the whole
    process ("Null bucket in octree"). The middles of regular meshes do so often; a box that is no
    simple multiple of the mesh prevents it.
    """
    low, high = space.min(axis=0), space.max(axis=0)
    size = float((high - low).max())
    corners = np.stack([low - size * np.array([0.0731, 0.0617, 0.0317]),
                        high + size * np.array([0.0519, 0.0823, 0.0413])])  # fmt: skip
    tiny = 1e-3 * size * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return corners[:, None] + tiny
