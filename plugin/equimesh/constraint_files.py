"""Constraint lines and points from files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from equimesh.errors import InputError

__all__ = ["read_constraints"]


def read_constraints(path: Path) -> list[tuple[str | None, shapely.Geometry]]:
    """Geometries of a file, each with the attribute ``name`` that it has there.

    GeoJSON is read as it is; a shapefile or any other vector format of GDAL through pyogrio.

    Raises
    ------
    InputError
        There is no such file, it is damaged, has no geometries, or pyogrio is not installed.
    """
    if not path.is_file():
        raise InputError(f"There is no file {path}: check the name of the constraints' file.")
    if path.suffix.lower() in (".geojson", ".json"):
        found = _from_geojson(path)
    else:
        found = _from_vector_file(path)
    if not found:
        raise InputError(f"The file {path} has no lines and no points: give another one.")
    return found


def _from_geojson(path: Path) -> list[tuple[str | None, shapely.Geometry]]:
    try:
        return _features(json.loads(path.read_bytes()))
    except (ValueError, TypeError, KeyError, RecursionError, AttributeError, shapely.GEOSException):
        raise InputError(
            f"The file {path} is not GeoJSON: give one with lines and points."
        ) from None


def _features(thing: dict[str, Any]) -> list[tuple[str | None, shapely.Geometry]]:
    if thing["type"] == "FeatureCollection":
        return [pair for feature in thing["features"] for pair in _features(feature)]
    if thing["type"] == "Feature":
        if thing["geometry"] is None:
            return []
        name = (thing.get("properties") or {}).get("name")
        geometry = shapely.from_geojson(json.dumps(thing["geometry"]))
        return [(None if name is None else str(name), geometry)]
    return [(None, shapely.from_geojson(json.dumps(thing)))]


def _from_vector_file(path: Path) -> list[tuple[str | None, shapely.Geometry]]:
    try:
        from pyogrio.errors import DataSourceError
        from pyogrio.raw import read
    except ImportError:
        raise InputError(
            f"To read {path} pyogrio is needed: pip install 'equimesh[vector]', or give GeoJSON."
        ) from None
    try:
        meta, _, geometries, columns = read(path, force_2d=True)
    except (DataSourceError, ValueError):
        raise InputError(
            f"The file {path} cannot be read: it is damaged or no vector file."
        ) from None
    fields = [str(name).lower() for name in meta["fields"]]
    names = columns[fields.index("name")] if "name" in fields else np.full(len(geometries), None)
    return [
        (None if name is None else str(name), shapely.from_wkb(geometry))
        for name, geometry in zip(names, geometries, strict=True)
        if geometry is not None
    ]
