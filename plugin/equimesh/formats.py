"""Files in and out, by suffix, through whatever adapters are installed.

The core reads no format itself. A distribution that does declares, in the entry-point group
``equimesh.adapters``, one ``Format`` for each family of suffixes.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.surface import Surface
from equimesh.outputs import staged

if TYPE_CHECKING:
    from equimesh.result import Result

__all__ = [
    "GROUP", "Format", "TriangleMesh", "formats", "in_projection", "in_space", "load", "load_mesh",
    "save", "writer",
]  # fmt: skip

GROUP = "equimesh.adapters"


class TriangleMesh(NamedTuple):
    """``points`` (n, 2) or (n, 3) float64 and ``triangles`` (m, 3) int64."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Format:
    """A family of files.

    Parameters
    ----------
    suffixes
        With their dot, in lower case, such as ``(".ply", ".stl")``.
    read
        From a path to a mesh or to any other field. May raise whatever its library raises; the
        caller makes one sentence of it. InputError passes as it is.
    write
        To a path, which is a draft that is moved into place afterwards; None where results cannot
        be kept in such a file.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path], TriangleMesh | Field]
    write: Callable[[Path, Result], None] | None = None


def formats() -> dict[str, Format]:
    """Every known suffix with its format; of two adapters for one suffix, the first by name."""
    table: dict[str, Format] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            family: Format = entry.load()
        except (ImportError, AttributeError) as error:
            warnings.warn(f"The adapter {entry.name} is left out: {error}", stacklevel=2)
            continue
        for suffix in family.suffixes:
            table.setdefault(suffix, family)
    return table


def load(path: str | Path, *, up: Any = None) -> Field:
    """The file as a field: a triangle mesh becomes a ``Surface``, seen along ``up``.

    Raises InputError, saying in one sentence what is wrong with the file.
    """
    content = _read(Path(path))
    if isinstance(content, TriangleMesh):
        points = content.points
        if points.shape[1] == 2:
            points = np.column_stack([points, np.zeros(len(points))])
        return Surface(points, content.triangles, up=up)
    if up is not None:
        raise InputError(f"{path} is not a triangle surface: leave out the direction `up`.")
    return content


def load_mesh(path: str | Path) -> TriangleMesh:
    """The triangles of a mesh file, as they are stored.

    Raises InputError, saying in one sentence what is wrong with the file.
    """
    content = _read(Path(path))
    if not isinstance(content, TriangleMesh):
        raise InputError(f"{path} holds no triangles: give a mesh file.")
    return content


def in_space(result: Result, field: Field) -> Result:
    """The result with its points in the coordinates of the input.

    A surface that is a graph over a tilted plane is meshed in that plane; its profile stays there.
    """
    if not isinstance(field, Surface):
        return result
    return dataclasses.replace(result, points=field.to_input(result.points))


def in_projection(points: NDArray[np.float64], field: Field) -> NDArray[np.float64]:
    """(n, 3) points in space as the field sees them, heights last: the way back of ``in_space``."""
    if not isinstance(field, Surface) or points.shape[1] == 2:
        return points
    return np.asarray(points @ field.to_input(np.eye(3)).T)


def save(path: str | Path, result: Result) -> None:
    """Write a result in the format of the suffix; the file appears complete or not at all."""
    target = Path(path)
    write = writer(target)
    with staged([target]) as (draft,):
        write(draft, result)


def writer(path: Path) -> Callable[[Path, Result], None]:
    """What writes a result to such a path; InputError where nothing does."""
    table = formats()
    family = table.get(path.suffix.lower())
    if family is None or family.write is None:
        raise _unknown(path, [suffix for suffix, family in table.items() if family.write])
    return family.write


def _read(path: Path) -> TriangleMesh | Field:
    table = formats()
    if path.is_dir():
        raise InputError(f"{path} is a folder: give a file.")
    if not path.is_file():
        raise InputError(f"There is no file {path}: check the name.")
    family = table.get(path.suffix.lower())
    if family is None:
        raise _unknown(path, list(table))
    if path.stat().st_size == 0:
        raise InputError(f"The file {path} is empty: give another one.")
    try:
        content = family.read(path)
        return _sound(path, content) if isinstance(content, TriangleMesh) else content
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"The file {path} does not fit into memory: give a smaller one.") from None
    except (Exception, SystemExit) as error:  # whatever a library may raise
        raise InputError(
            f"The file {path} cannot be read as {path.suffix}: it is damaged or of another kind."
        ) from error


def _sound(path: Path, mesh: TriangleMesh) -> TriangleMesh:
    if np.asarray(mesh.triangles).dtype.kind not in "iu":
        raise InputError(f"The triangles of {path} are not whole numbers: correct the file.")
    points = np.ascontiguousarray(mesh.points, np.float64)
    triangles = np.ascontiguousarray(mesh.triangles, np.int64).reshape(-1, 3)
    if len(triangles) == 0:
        raise InputError(f"The file {path} has no triangles: give a triangulated surface.")
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"The points of {path} do not have two or three coordinates.")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"A triangle of {path} names a vertex that does not exist: repair it.")
    if not np.isfinite(points).all():
        raise InputError(f"The file {path} has NaN or infinite coordinates: remove such vertices.")
    return TriangleMesh(points, triangles)


def _unknown(path: Path, known: list[str]) -> InputError:
    if not known:
        return InputError("No file formats are installed: install equimesh with pip.")
    kind = f"The suffix {path.suffix}" if path.suffix else f"{path} without a suffix"
    return InputError(f"{kind} is not known here: use one of {' '.join(sorted(known))}.")
