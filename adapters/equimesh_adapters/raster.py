"""Rasters: files, open rasterio datasets and xarray's ``DataArray``.

Files are ``.npy``, Esri ASCII grids (``.asc``) and GeoTIFF (``.tif``, the extra `raster`). Samples
lie at the centres of cells, wherever the affine transform puts these; missing samples become holes;
the coordinate reference system goes into the result's ``metadata``: ``crs`` as text and ``prj`` as
Esri writes it, which ``save`` puts into a ``.prj`` file beside the mesh.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.raster import Raster
from equimesh.formats import Format
from equimesh_adapters import dataarray

__all__ = ["FORMAT", "from_result", "profile", "remesh", "to_field"]

ASCII_KEYS = {
    "ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "dx", "dy",
    "nodata_value",
}  # fmt: skip


def to_field(raster: Any, *, band: int | None = None) -> Raster:
    """A ``DataArray`` or an open rasterio dataset as a field.

    Parameters
    ----------
    raster
        A ``DataArray`` in any order of its dimensions, equally spaced along x and y, or a rasterio
        dataset. Scale and offset, where they are still to be applied, are applied.
    band
        Counted from 1; needed where there are several.

    Raises
    ------
    InputError
        Another object, a band that does not exist, or coordinates that are no affine grid.
    """
    if dataarray.is_dataarray(raster):
        return dataarray.to_raster(raster, band)
    if not (hasattr(raster, "read") and hasattr(raster, "transform")):
        raise InputError(
            f"A {type(raster).__name__} is no raster: give an xarray DataArray, one variable of a "
            "Dataset, or an open rasterio dataset."
        )
    index = dataarray.band_index(band, raster.count, "The file") + 1
    return Raster(
        raster.read(index, masked=True),
        transform=dataarray.centred(tuple(raster.transform)[:6]),
        scale=raster.scales[index - 1],
        offset=raster.offsets[index - 1],
        metadata=dataarray.reference(raster.crs),
    )


def from_result(result: equimesh.Result, like: Any, *, band: int | None = None) -> Any:
    """The heights of the mesh at the samples of ``like``: how the mesh looks as a raster.

    A ``DataArray`` gives one with the same coordinates, attributes (but those of the encoding) and
    name, NaN where there is no mesh; a rasterio dataset gives a masked array (rows, columns), as
    its ``read`` does.
    """
    grid = to_field(like, band=band)
    rows, columns = grid.heights.shape
    row, column = (index.ravel() for index in np.indices((rows, columns)))
    a, b, c, d, e, f = grid.transform or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    mesh = equimesh.Surface(result.points, result.triangles, up="z")
    heights = mesh.value(a * column + b * row + c, d * column + e * row + f).reshape(rows, columns)
    if dataarray.is_dataarray(like):
        return dataarray.with_heights(like, heights, band)
    return np.ma.masked_invalid(heights)


def remesh(
    raster: Any, tol: float | str | None = None, *, band: int | None = None, **options: Any
) -> Any:
    """``equimesh.remesh`` from a raster to the same kind of raster, sampled from the mesh.

    It differs by at most the tolerance. The mesh itself is ``equimesh.remesh(to_field(raster))``.
    Raises InputError where the tolerance is not met.
    """
    result = equimesh.remesh(to_field(raster, band=band), tol, **options)
    if not result.status.usable:
        raise InputError(result.status.value)
    return from_result(result, raster, band=band)


def profile(mesh: Any, against: Any, *, band: int | None = None) -> equimesh.Profile:
    """The errors of a mesh, anything with ``points`` and ``triangles``, against a raster."""
    return equimesh.profile(mesh.points, mesh.triangles, to_field(against, band=band))


def read(path: Path, band: int | None = None) -> Raster:
    if path.suffix.lower() in (".tif", ".tiff"):
        return _read_tiff(path, band)
    dataarray.band_index(band, 1, str(path))
    if path.suffix.lower() == ".asc":
        return _read_ascii(path)
    # Pickles could run code: NumPy raises ValueError instead of opening one.
    return Raster(np.load(path, allow_pickle=False))


def _read_ascii(path: Path) -> Raster:
    """A header of names with numbers, then samples row by row from the north.

    Read here rather than by GDAL, which would round most samples to single precision.
    """
    with path.open(encoding="utf-8-sig") as file:
        header: dict[str, float] = {}
        for line in file:
            name, *rest = line.split() or [""]
            if name.lower() not in ASCII_KEYS:
                break
            header[name.lower()] = float(rest[0])
        else:
            line = ""
        samples = np.array((line + " " + file.read()).split(), np.float64)
    lost = {"ncols", "nrows"} - header.keys()
    if lost:
        raise InputError(f"The header of {path} lacks {' and '.join(sorted(lost))}: add it.")
    columns, rows = int(header["ncols"]), int(header["nrows"])
    if len(samples) != rows * columns:
        raise InputError(
            f"{path} announces {rows} x {columns} samples but holds {len(samples)}: "
            "it is cut short or damaged."
        )
    dx = header.get("dx", header.get("cellsize", 1.0))
    dy = header.get("dy", header.get("cellsize", 1.0))
    west = header.get("xllcenter", header.get("xllcorner", 0.0) + 0.5 * dx)
    south = header.get("yllcenter", header.get("yllcorner", 0.0) + 0.5 * dy)
    beside = path.with_suffix(".prj")
    prj = beside.read_text(encoding="utf-8", errors="replace") if beside.is_file() else ""
    return Raster(
        samples.reshape(rows, columns),
        transform=(dx, 0.0, west, 0.0, -dy, south + (rows - 1) * dy),
        nodata=header.get("nodata_value", -9999.0),
        metadata={"crs": prj, "prj": prj} if prj.strip() else {},
    )


def _read_tiff(path: Path, band: int | None) -> Raster:
    try:
        import rasterio
    except ImportError:
        raise InputError(
            f"Reading {path.suffix} needs rasterio: run pip install 'equimesh[raster]'."
        ) from None
    # The driver is named so that no other kind of file can hide behind the suffix.
    with rasterio.open(path, driver="GTiff") as file:
        return to_field(file, band=band)


FORMAT = Format(
    (".npy", ".asc", ".tif", ".tiff"),
    read,
    bands=True,
    types=("xarray.DataArray", "rasterio.DatasetReader"),
    to_field=to_field,
    remesh=remesh,
)
