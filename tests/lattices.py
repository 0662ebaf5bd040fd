"""Lattices that several test files lay."""

import numpy as np

from equimesh.boundary import boundary_nodes
from equimesh.domain import Sides, sides_of
from equimesh.fields.function import Function
from equimesh.seeding import lattice_points


def laid(text, tol, domain, expected, **options):
    """(n, 2) vertices of the lattice of a function in the user's coordinates, in the order in which
    they were laid; ``options`` are those of ``lattice_points``."""
    function = Function(text)
    kernel, frame = function.kernel(domain, tol), function.frame(domain)
    sides = sides_of(domain)
    local = Sides(frame.to_local(sides.corners), sides.following, sides.tags, sides.names)
    floor = float(np.ptp(local.corners, axis=0).max()) ** -2
    nodes = boundary_nodes(kernel, local, tol, floor)
    return frame.to_user(lattice_points(kernel, local, nodes, tol, floor, expected, **options))
