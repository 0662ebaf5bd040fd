"""What the command line's words mean."""

from __future__ import annotations

import json
import math
from pathlib import Path

import shapely

from equimesh.errors import InputError

__all__ = ["direction", "region"]

Box = tuple[float, float, float, float]


def direction(text: str) -> tuple[float, float, float]:
    """``x``, ``y``, ``z``, ``-z`` or three numbers with commas, as a vector.

    >>> direction("-z"), direction("0,1,1")
    ((0.0, 0.0, -1.0), (0.0, 1.0, 1.0))
    """
    word = text.strip().lower()
    axis = word.lstrip("+-")
    if axis in ("x", "y", "z") and len(word) - len(axis) <= 1:
        one = -1.0 if word.startswith("-") else 1.0
        x, y, z = (one if axis == name else 0.0 for name in "xyz")
        return (x, y, z)
    numbers = _numbers(word)
    if len(numbers) != 3 or not any(numbers):
        raise InputError(
            f"The direction {text!r} is not known: give x, y, z or three numbers such as 0,0,1."
        )
    return (numbers[0], numbers[1], numbers[2])


def region(text: str) -> Box | shapely.Geometry:
    """``xmin,ymin,xmax,ymax``, a polygon as WKT, or the name of a GeoJSON file.

    >>> region("0, 0, 1, 2")
    (0.0, 0.0, 1.0, 2.0)
    >>> region("POLYGON ((0 0, 1 0, 0 1, 0 0))").area
    0.5
    """
    numbers = _numbers(text)
    if len(numbers) == 4:
        return (numbers[0], numbers[1], numbers[2], numbers[3])
    if Path(text).suffix.lower() in (".geojson", ".json"):
        return _polygons(_geojson(Path(text)), text)
    try:
        geometry = shapely.from_wkt(text)
    except shapely.errors.ShapelyError:
        raise InputError(
            f"The domain {text[:60]!r} is not known: give xmin,ymin,xmax,ymax, a POLYGON in WKT, "
            "or a .geojson file."
        ) from None
    return _polygons(geometry, text)


def _numbers(text: str) -> list[float]:
    """The numbers between commas; none at all if one of them is no finite number."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def _geojson(path: Path) -> shapely.Geometry:
    if not path.is_file():
        raise InputError(f"There is no file {path}: check the name of the domain's file.")
    try:
        return shapely.from_geojson(json.dumps(json.loads(path.read_bytes())))
    except (ValueError, RecursionError, shapely.errors.ShapelyError):
        raise InputError(f"The file {path} is not GeoJSON: give one with a polygon.") from None


def _polygons(geometry: shapely.Geometry, text: str) -> shapely.Geometry:
    """A collection of polygons as their union; the domain itself is checked when it is used."""
    if geometry.geom_type in ("Polygon", "MultiPolygon"):
        return geometry
    parts = shapely.get_parts(geometry)
    if not len(parts) or not all(part.geom_type in ("Polygon", "MultiPolygon") for part in parts):
        raise InputError(f"The domain {text[:60]!r} is not a polygon: give one, holes allowed.")
    broken = [part for part in parts if not part.is_valid]
    return broken[0] if broken else shapely.union_all(parts)
