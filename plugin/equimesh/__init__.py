"""equimesh: the mesh with the fewest triangles that represents a surface to within a tolerance."""

from __future__ import annotations

from equimesh.errors import Cancelled, InputError
from equimesh.fields import Field, Function, Raster, Surface, as_field
from equimesh.flat import FlatMesh, flat_mesh
from equimesh.flatness import Flatness, flatness
from equimesh.profile import Profile, profile
from equimesh.remesh import remesh
from equimesh.result import Boundary, Constraints, Result, Status
from equimesh.riemann.metric import Metric
from equimesh.transform import FlatMap

__all__ = [
    "Boundary",
    "Cancelled",
    "Constraints",
    "Field",
    "FlatMap",
    "FlatMesh",
    "Flatness",
    "Function",
    "InputError",
    "Metric",
    "Profile",
    "Raster",
    "Result",
    "Status",
    "Surface",
    "as_field",
    "flat_mesh",
    "flatness",
    "profile",
    "remesh",
]
