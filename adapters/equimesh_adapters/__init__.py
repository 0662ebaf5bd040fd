"""Files and mesh libraries in and out of equimesh: one module for each tool.

``load`` and ``remesh`` take a file by its name or an object of a library, and ``save`` a file; the
adapter is found by the suffix or the type.

>>> import equimesh_adapters
>>> field = equimesh_adapters.load("missing.ply")
Traceback (most recent call last):
equimesh.errors.InputError: There is no file missing.ply: check the name.
"""

from equimesh.formats import load, load_mesh, remesh, save

__all__ = ["load", "load_mesh", "remesh", "save"]
