"""A raster: real terrain within 2 % of its range, written for other programs."""

import matplotlib
import numpy as np

import equimesh
import equimesh_adapters

elevation = np.load(f"{matplotlib.get_data_path()}/sample_data/jacksboro_fault_dem.npz")[
    "elevation"
]
result = equimesh.remesh(elevation, tol="2%")
print(f"{elevation.size} samples became {len(result.points)} vertices")
print(f"every height is kept within {result.profile.bound:.1f} m, asked for {result.tol:.1f} m")
equimesh_adapters.save("jacksboro.vtu", result)
