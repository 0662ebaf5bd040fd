"""NumPy archives: a mesh as ``points`` and ``triangles``, or a raster as the one 2-D array."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.raster import Raster
from equimesh.formats import Format, TriangleMesh

__all__ = ["FORMAT"]


def read(path: Path) -> TriangleMesh | Field:
    # Pickles could run code: NumPy raises ValueError instead of opening one.
    with np.load(path, allow_pickle=False) as archive:
        if {"points", "triangles"} <= set(archive.files):
            return TriangleMesh(archive["points"], archive["triangles"])
        arrays = {name: archive[name] for name in archive.files}
    plane = [name for name, array in arrays.items() if array.ndim == 2]
    if len(plane) != 1:
        found = ", ".join(plane) or "none"
        raise InputError(
            f"{path} must hold one 2-D array, or points and triangles: its 2-D arrays are {found}."
        )
    return Raster(arrays[plane[0]])


def write(path: Path, result: equimesh.Result) -> None:
    np.savez_compressed(
        path, points=result.points, triangles=result.triangles, error=result.profile.errors
    )


FORMAT = Format((".npz",), read, write)
