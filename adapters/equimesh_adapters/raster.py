"""Rasters: ``.npy``, Esri ASCII grids (``.asc``), and GeoTIFF (``.tif``, the extra `raster`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from equimesh.errors import InputError
from equimesh.fields.raster import Raster
from equimesh.formats import Format

__all__ = ["FORMAT"]

ASCII_KEYS = {
    "ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "dx", "dy",
    "nodata_value",
}  # fmt: skip


def read(path: Path) -> Raster:
    match path.suffix.lower():
        case ".npy":
            # Pickles could run code: NumPy raises ValueError instead of opening one.
            return Raster(np.load(path, allow_pickle=False))
        case ".asc":
            return _read_ascii(path)
        case _:
            return _read_tiff(path)


def _read_ascii(path: Path) -> Raster:
    """A header of names with numbers, then samples row by row from the north."""
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
    return Raster(
        samples.reshape(rows, columns),
        transform=(dx, 0.0, west, 0.0, -dy, south + (rows - 1) * dy),
        nodata=header.get("nodata_value", -9999.0),
    )


def _read_tiff(path: Path) -> Raster:
    try:
        import rasterio
    except ImportError:
        raise InputError(
            f"Reading {path.suffix} needs rasterio: run pip install 'equimesh[raster]'."
        ) from None
    # The driver is named so that no other kind of file can hide behind the suffix.
    with rasterio.open(path, driver="GTiff") as file:
        if file.count != 1:
            raise InputError(f"{path} has {file.count} bands: give one band of heights.")
        heights = file.read(1, masked=True)
        a, b, c, d, e, f = tuple(file.transform)[:6]
    # The file's transform is for corners of cells, and samples lie at their centres.
    return Raster(heights, transform=(a, b, c + 0.5 * (a + b), d, e, f + 0.5 * (d + e)))


FORMAT = Format((".npy", ".asc", ".tif", ".tiff"), read)
