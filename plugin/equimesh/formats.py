"""Files by suffix and objects by type, through whatever adapters are installed.

The core reads no format itself and knows no mesh library. A distribution that does declares, in the
entry-point group ``equimesh.adapters``, one ``Format`` for each family of files or objects.
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
    "GROUP", "Format", "TriangleMesh", "families", "family_of", "files_of", "formats",
    "in_projection", "in_space", "load", "load_mesh", "remesh", "save", "writer",
]  # fmt: skip

GROUP = "equimesh.adapters"


class TriangleMesh(NamedTuple):
    """``points`` (n, 2) or (n, 3) float64 and ``triangles`` (m, 3) int64."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Format:
    """A family of files, of objects, or of both.

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
    bands
        Whether ``read`` takes a ``band``, counted from 1 or None.
    types
        Classes of objects as their users write them, package and class, such as
        ``("trimesh.Trimesh",)``, in whichever module of the package they are defined. They are
        compared as text, with those of base classes too, so no library need be imported.
    to_field
        From such an object, and keywords such as ``up``, to a field.
    remesh
        From such an object, a tolerance and keywords to an object of the same kind.
    """

    suffixes: tuple[str, ...] = ()
    read: Callable[..., TriangleMesh | Field] | None = None
    write: Callable[[Path, Result], None] | None = None
    bands: bool = False
    types: tuple[str, ...] = ()
    to_field: Callable[..., Field] | None = None
    remesh: Callable[..., Any] | None = None


def families() -> list[Format]:
    """All adapters that are installed and whole, in the order of their names."""
    found: list[Format] = []
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            family: Format = entry.load()
        except (ImportError, AttributeError) as error:
            warnings.warn(f"The adapter {entry.name} is left out: {error}", stacklevel=3)
            continue
        found.append(family)
    return found


def formats() -> dict[str, Format]:
    """Every known suffix with its format; of two adapters for one suffix, the first by name."""
    table: dict[str, Format] = {}
    for family in families():
        for suffix in family.suffixes:
            table.setdefault(suffix, family)
    return table


def family_of(thing: object) -> Format:
    """The adapter for an object: that of its own class, else of the nearest base class.

    Raises InputError where no adapter names its type.
    """
    table: dict[str, Format] = {}
    for family in families():
        for name in family.types:
            table.setdefault(name, family)
    for kind in type(thing).__mro__:
        package = kind.__module__.partition(".")[0]
        for name in (f"{kind.__module__}.{kind.__qualname__}", f"{package}.{kind.__qualname__}"):
            if name in table:
                return table[name]
    raise InputError(
        f"A {type(thing).__name__} is of no known type: use one of {', '.join(sorted(table))}."
    )


def load(source: Any, *, up: Any = None, band: int | None = None, **options: Any) -> Field:
    """A file, by its name, or an object of a mesh library as a field.

    A triangle mesh becomes a ``Surface``, seen along ``up``. Of a raster with several bands,
    ``band`` chooses one, counted from 1. Further ``options`` go to the adapter of an object.

    Raises InputError, saying in one sentence what is wrong with the file or the object.
    """
    if not isinstance(source, (str, Path)):
        family = family_of(source)
        if family.to_field is None:
            raise InputError(f"A {type(source).__name__} cannot be read as a surface: save it.")
        given = {"up": up, "band": band}
        options |= {name: value for name, value in given.items() if value is not None}
        return family.to_field(source, **options)
    path = Path(source)
    if options:
        raise InputError(f"{next(iter(options))}= is for objects: leave it out for files.")
    content = _read(path, band)
    if isinstance(content, TriangleMesh):
        points = content.points
        if points.shape[1] == 2:
            points = np.column_stack([points, np.zeros(len(points))])
        return Surface(points, content.triangles, up=up)
    if up is not None:
        raise InputError(f"{path} is not a triangle surface: leave out the direction `up`.")
    return content


def remesh(source: Any, tol: float | str | None = None, **options: Any) -> Any:
    """``equimesh.remesh`` for a file or an object of a mesh library; ``options`` are passed on.

    An object gives one of the same kind, with what its adapter carries over; a file, by its name, a
    ``Result`` in the coordinates of the file. Of a file, ``up`` and ``band`` choose as in ``load``.

    Raises InputError where there is no adapter, and where the input cannot be meshed.
    """
    if not isinstance(source, (str, Path)):
        family = family_of(source)
        if family.remesh is None:
            raise InputError(f"There is no remesh for a {type(source).__name__}: load it instead.")
        return family.remesh(source, tol, **options)
    from equimesh.remesh import remesh as remesh_field

    field = load(source, up=options.pop("up", None), band=options.pop("band", None))
    return in_space(remesh_field(field, tol, **options), field)


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
    """Write a result in the format of the suffix; the file appears complete or not at all.

    Where the source told its coordinate reference system, a ``.prj`` file beside it says so.
    """
    files = files_of(Path(path), result)
    with staged(list(files)) as drafts:
        for draft, write in zip(drafts, files.values(), strict=True):
            write(draft)


def files_of(path: Path, result: Result) -> dict[Path, Callable[[Path], object]]:
    """The files that a result goes into, each with what writes it to a draft."""
    write = writer(path)
    files: dict[Path, Callable[[Path], object]] = {path: lambda draft: write(draft, result)}
    prj = result.metadata.get("prj")
    if prj:
        files[path.with_suffix(".prj")] = lambda draft: draft.write_text(prj, encoding="utf-8")
    return files


def writer(path: Path) -> Callable[[Path, Result], None]:
    """What writes a result to such a path; InputError where nothing does."""
    table = formats()
    family = table.get(path.suffix.lower())
    if family is None or family.write is None:
        raise _unknown(path, [suffix for suffix, family in table.items() if family.write])
    return family.write


def _read(path: Path, band: int | None = None) -> TriangleMesh | Field:
    table = formats()
    if path.is_dir():
        raise InputError(f"{path} is a folder: give a file.")
    if not path.is_file():
        raise InputError(f"There is no file {path}: check the name.")
    family = table.get(path.suffix.lower())
    if family is None or family.read is None:
        raise _unknown(path, [suffix for suffix, family in table.items() if family.read])
    if path.stat().st_size == 0:
        raise InputError(f"The file {path} is empty: give another one.")
    if band is not None and not family.bands:
        raise InputError(f"{path} has no bands: leave out the band.")
    try:
        content = family.read(path, band) if family.bands else family.read(path)
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
