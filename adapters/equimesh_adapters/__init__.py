"""Files and mesh libraries in and out of equimesh: one module for each tool.

>>> import equimesh_adapters
>>> field = equimesh_adapters.load("missing.ply")
Traceback (most recent call last):
equimesh.errors.InputError: There is no file missing.ply: check the name.
"""

from equimesh.formats import load, load_mesh, save

__all__ = ["load", "load_mesh", "save"]
