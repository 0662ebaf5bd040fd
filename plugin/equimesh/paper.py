"""Where the program is that makes the paper's tables and figures again, and how it is run."""

from __future__ import annotations

import runpy
import sys
from importlib.util import find_spec
from pathlib import Path

from equimesh.errors import InputError

__all__ = ["program", "reproduce"]

PLACE = ("examples", "paper")


def program() -> Path:
    """The folder of the program: packed into the installed package, or in the checkout around it.

    Raises InputError where neither is there.
    """
    here = Path(__file__).parent
    for root in (here, here.parents[1]):
        folder = root.joinpath(*PLACE)
        if (folder / "__main__.py").is_file():
            return folder
    raise InputError(
        f"The program {'/'.join(PLACE)} is missing here: install equimesh from its repository."
    )


def reproduce(folder: Path) -> None:
    """Write the page with tables and figures to a folder, which is created if need be.

    Raises InputError where the extra `paper` is not installed, and OSError.
    """
    for module, name in (("skfem", "scikit-fem"), ("matplotlib", "matplotlib")):
        if find_spec(module) is None:
            raise InputError(f"The paper needs {name}: run pip install 'equimesh[paper]'.")
    start = program()
    before = sys.argv
    sys.argv = [str(start), str(folder)]
    try:
        runpy.run_path(str(start), run_name="__main__")
    finally:
        sys.argv = before
