"""What PyVista imports when someone first writes ``dataset.equimesh``."""

import pyvista

from equimesh_adapters.pyvista import Accessor

__all__: list[str] = []

for _kind in (
    pyvista.PolyData, pyvista.ImageData, pyvista.RectilinearGrid, pyvista.StructuredGrid,
):  # fmt: skip
    pyvista.register_dataset_accessor("equimesh", _kind)(Accessor)
