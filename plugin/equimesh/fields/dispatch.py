"""The four questions to a field, sent to the kernels of its kind."""

from __future__ import annotations

from equimesh.fields import kink_kernels, patch_kernels, raster_kernels, surface_kernels
from equimesh.fields.compiled import outlined
from equimesh.fields.kernel import PATCHES, RASTER

__all__ = ["edge_error", "gradient", "inner_error", "value"]


@outlined
def value(F, x, y):
    """Height at (x, y); NaN outside the field."""
    if F.kind == PATCHES:
        return patch_kernels.value(F, x, y)
    if F.kind == RASTER:
        return raster_kernels.value(F, x, y)
    return surface_kernels.value(F, x, y)


@outlined
def gradient(F, x, y):
    """(f_x, f_y) at (x, y)."""
    if F.kind == PATCHES:
        return patch_kernels.gradient(F, x, y)
    if F.kind == RASTER:
        return raster_kernels.gradient(F, x, y)
    return surface_kernels.gradient(F, x, y)


@outlined
def edge_error(F, ax, ay, az, bx, by, bz, stop):
    """Signed largest error on an edge and its parameter s; any error above ``stop`` will do."""
    if F.kind == PATCHES:
        return kink_kernels.edge_error(F, ax, ay, az, bx, by, bz, stop)
    if F.kind == RASTER:
        return raster_kernels.edge_error(F, ax, ay, az, bx, by, bz, stop)
    return surface_kernels.edge_error(F, ax, ay, az, bx, by, bz, stop)


@outlined
def inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop):
    """Signed largest error strictly inside a triangle and where; any above ``stop`` will do."""
    if F.kind == PATCHES:
        return kink_kernels.inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop)
    if F.kind == RASTER:
        return raster_kernels.inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop)
    return surface_kernels.inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop)
