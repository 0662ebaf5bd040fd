"""A triangle surface: a fine mesh made coarse, and the same certificate for someone else's mesh."""

import numpy as np
import trimesh
from scipy.spatial import Delaunay

import equimesh
from equimesh_adapters.trimesh import from_result, to_field

xy = np.random.default_rng(1).random((20_000, 2))
z = np.exp(-20 * ((xy[:, 0] - 0.5) ** 2 + (xy[:, 1] - 0.5) ** 2))
fine = trimesh.Trimesh(np.column_stack([xy, z]), Delaunay(xy).simplices, process=False)

surface = to_field(fine)
result = equimesh.remesh(surface, tol="1%")
coarse = from_result(result)
print(f"{len(fine.faces)} triangles became {len(coarse.faces)}, within {result.profile.bound:.4f}")

other = equimesh.profile(coarse.vertices + np.array([0, 0, 0.001]), coarse.faces, surface)
print(f"lifted by 0.001 the error is {other.max:.4f} at most, certified below {other.bound:.4f}")
