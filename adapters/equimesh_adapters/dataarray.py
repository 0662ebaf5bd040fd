"""xarray's ``DataArray`` as a raster: which dimensions are x and y, where samples lie, the CRS.

Nothing is imported: whoever has such an object has xarray. The coordinate reference system is found
as the CF conventions and rioxarray keep it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from equimesh.errors import InputError
from equimesh.fields.raster import Raster

__all__ = [
    "band_index", "centred", "is_dataarray", "reference", "to_raster", "with_heights",
]  # fmt: skip

NAMES = {
    "X": {"x", "lon", "longitude", "easting", "projection_x_coordinate", "grid_longitude"},
    "Y": {"y", "lat", "latitude", "northing", "projection_y_coordinate", "grid_latitude"},
}
MISSING = ("_FillValue", "missing_value", "nodata")
SCALED = ("scale_factor", "add_offset")  # among the attributes only while values are still packed

Six = tuple[float, float, float, float, float, float]


def is_dataarray(raster: Any) -> bool:
    return all(hasattr(raster, name) for name in ("dims", "coords", "isel", "values")) and not (
        hasattr(raster, "data_vars")
    )


def to_raster(array: Any, band: int | None) -> Raster:
    """The samples (y, x) of a ``DataArray`` with the grid that its coordinates describe."""
    plane = _plane(array, band)
    y, x = plane.dims
    missing = next((plane.attrs[key] for key in MISSING if key in plane.attrs), None)
    return Raster(
        np.asarray(plane.values),
        transform=_transform(plane, x, y),
        nodata=None if missing is None else float(np.ravel(missing)[0]),
        scale=plane.attrs.get(SCALED[0], 1.0),
        offset=plane.attrs.get(SCALED[1], 0.0),
        metadata=reference(_crs(plane)),
    )


def with_heights(array: Any, heights: np.ndarray, band: int | None) -> Any:
    """A ``DataArray`` like ``array`` with the heights (y, x), NaN where they are missing."""
    plane = _plane(array, band)
    filled = plane.copy(data=heights)
    packing = MISSING + SCALED
    filled.attrs = {key: value for key, value in plane.attrs.items() if key not in packing}
    return filled.transpose(*(name for name in array.dims if name in plane.dims))


def band_index(band: int | None, count: int, owner: str) -> int:
    """The position, from 0, of a band that is counted from 1; one band need not be named."""
    if band is None and count != 1:
        raise InputError(f"{owner} has {count} bands: choose one with band=1 to {count}.")
    index = 1 if band is None else band
    if not 1 <= index <= count:
        raise InputError(f"{owner} has no band {band}: choose one from 1 to {count}.")
    return index - 1


def centred(transform: Sequence[float]) -> Six:
    """From the corners of cells, which GDAL's transforms describe, to their centres."""
    a, b, c, d, e, f = map(float, transform)
    return a, b, c + 0.5 * (a + b), d, e, f + 0.5 * (d + e)


def reference(crs: Any) -> dict[str, str]:
    """A coordinate reference system, rasterio's or text, as ``metadata``; nothing if there is none.

    ``prj`` is left out where it needs rasterio, which is absent, or has no such form.
    """
    if not crs:
        return {}
    with contextlib.suppress(ImportError, ValueError):  # rasterio's CRSError is a ValueError
        from rasterio.crs import CRS

        known = CRS.from_user_input(crs)
        return {"crs": known.to_wkt(), "prj": known.to_wkt(version="WKT1_ESRI")}
    return {"crs": crs if isinstance(crs, str) else crs.to_wkt()}


def _plane(array: Any, band: int | None) -> Any:
    """The array with the dimensions (y, x) alone."""
    if array.ndim < 2:
        raise InputError(f"The DataArray has {array.ndim} dimensions: give one over x and y.")
    x, y = _axis(array, "X"), _axis(array, "Y")
    rest = [name for name in array.dims if name not in (x, y)]
    x = x or rest.pop()
    y = y or rest.pop()
    long = [name for name in rest if array.sizes[name] != 1]
    if len(long) > 1:
        raise InputError(
            f"The DataArray has the dimensions {', '.join(map(str, long))} beside x and y: "
            "select one layer with isel()."
        )
    count = array.sizes[long[0]] if long else 1
    index = band_index(band, count, "The DataArray")
    chosen = {name: index if name in long else 0 for name in rest}
    return array.isel(chosen, drop=True).transpose(y, x)


def _axis(array: Any, axis: str) -> Any:
    """The dimension that its coordinate or its name calls X or Y; None where none or two do."""
    found = []
    for name in array.dims:
        attrs = array.coords[name].attrs if name in array.coords else {}
        words = {str(name).lower(), str(attrs.get("standard_name", ""))}
        if attrs.get("axis") == axis or words & NAMES[axis]:
            found.append(name)
    return found[0] if len(found) == 1 else None


def _transform(plane: Any, x: Any, y: Any) -> Six:
    """Where samples lie: by the coordinates, else GDAL's transform, else the indices."""
    has = [name in plane.coords for name in (x, y)]
    if not any(has):
        words = str(_grid_mapping(plane).get("GeoTransform", "")).split()
        if len(words) == 6:
            c, a, b, f, d, e = map(float, words)
            return centred((a, b, c, d, e, f))
        curved = [str(name) for name in plane.coords if plane.coords[name].ndim > 1]
        if curved:
            raise InputError(
                f"The coordinates {', '.join(curved)} of the DataArray are curved: "
                "interpolate it to equally spaced ones."
            )
    west, dx = _spacing(plane, x) if has[0] else (0.0, 1.0)
    south, dy = _spacing(plane, y) if has[1] else (0.0, 1.0)
    return dx, 0.0, west, 0.0, dy, south


def _spacing(plane: Any, name: Any) -> tuple[float, float]:
    """First coordinate and step of a dimension whose samples are equally spaced."""
    given = np.asarray(plane.coords[name].values)
    if given.dtype.kind not in "iuf" or not np.isfinite(given).all():
        raise InputError(f"The coordinate {name} of the DataArray is no number: give lengths.")
    at = given.astype(np.float64)
    if len(at) < 2:
        return float(at[0]) if len(at) else 0.0, 1.0
    step = (at[-1] - at[0]) / (len(at) - 1)
    # Decimal fractions are rounded, and coordinates may be kept in single precision.
    rounding = np.finfo(given.dtype).eps * np.abs(at).max() if given.dtype.kind == "f" else 0.0
    off = np.abs(at[0] + step * np.arange(len(at)) - at).max()
    if off > 1e-5 * abs(step) + 2.0 * rounding or step == 0.0:
        raise InputError(
            f"The coordinate {name} of the DataArray is not equally spaced: "
            "interpolate it to equal steps."
        )
    return float(at[0]), float(step)


def _crs(plane: Any) -> Any:
    """Rioxarray's CRS, or the text that the CF conventions keep."""
    accessor = getattr(plane, "rio", None)
    if accessor is not None and accessor.crs is not None:
        return accessor.crs
    mapping = _grid_mapping(plane)
    return mapping.get("crs_wkt") or mapping.get("spatial_ref") or plane.attrs.get("crs")


def _grid_mapping(plane: Any) -> Mapping[str, Any]:
    name = plane.attrs.get("grid_mapping") or plane.encoding.get("grid_mapping", "spatial_ref")
    return plane.coords[name].attrs if name in plane.coords else {}
