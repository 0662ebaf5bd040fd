"""Surfaces z = f(x, y): functions, rasters and triangle surfaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.function import Function
from equimesh.fields.raster import Bound, Raster
from equimesh.fields.surface import Surface

__all__ = ["Bound", "Field", "Function", "Raster", "Source", "Surface", "as_field"]

Source: TypeAlias = (
    Callable[[NDArray[np.float64], NDArray[np.float64]], Any] | str | NDArray[Any] | Field
)


def as_field(
    source: Source, domain: shapely.Geometry | None = None, bound: Bound | None = None
) -> Field:
    """Turn what a caller gives into a field.

    A callable or text becomes a ``Function`` whose differences stay in the box of ``domain``, a 2-D
    array a ``Raster`` with x = column and y = row; a field stays what it is. ``bound`` tells where
    errors of a raster count; without it a raster's own choice stands.

    Raises
    ------
    InputError
        None of these, or a bound that is unknown or not for this source.
    """
    if bound is not None:
        field = as_field(source, domain)
        if isinstance(field, Raster):
            return field.bounded(bound)
        if bound != "surface":
            raise InputError(f"bound={bound!r} is for rasters only: leave it out.")
        return field
    if isinstance(source, Function):
        return source if domain is None or source.box is not None else source.on(domain)
    if isinstance(source, Field):
        return source
    if isinstance(source, str) or callable(source):
        function = Function(source)
        return function if domain is None else function.on(domain)
    if isinstance(source, (np.ndarray, list, tuple)):
        return Raster(np.asanyarray(source))
    raise InputError(
        f"A {type(source).__name__} is no surface: give a callable f(x, y), an expression in x "
        "and y, a 2-D array or a field."
    )
