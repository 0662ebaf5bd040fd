"""What the Gmsh adapter asks of the models that are open in Gmsh, and how it changes them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh_adapters.borders import border_edges
from equimesh_adapters.gmsh_fit import SAME, Curve, Patch
from equimesh_adapters.meshio import SPLITS

__all__ = [
    "CHORDS", "boundary_tags", "curves_of", "library", "only_surface", "opened", "plane_domain",
    "replace_mesh", "scratch", "surface_mesh",
]  # fmt: skip

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

POINT, LINE, TRIANGLE = 15, 1, 2  # Gmsh's numbers of element types
# Those that fall into triangles, with their nodes in the order that meshio has too.
FACES = {2: "triangle", 3: "quad", 9: "triangle6", 10: "quad9", 16: "quad8"}
CHORDS = 5e-3  # of the surface's size: how far chords stay from a curved boundary
DEEPEST = 12


def library() -> Any:
    """The module ``gmsh``; InputError where it is not installed."""
    try:
        import gmsh
    except (ImportError, OSError):  # OSError: its library lacks one of the system's
        raise InputError("Gmsh is not installed: pip install 'equimesh[gmsh]'.") from None
    return gmsh


def opened() -> Any:
    """The module ``gmsh``, initialised by its user."""
    gmsh = library()
    if not gmsh.isInitialized():
        raise InputError("Gmsh has no open model: call gmsh.initialize() and make or open one.")
    return gmsh


@contextlib.contextmanager
def scratch(name: str, options: Mapping[str, float]) -> Iterator[Any]:
    """Gmsh with a new, empty current model, silent; afterwards all is as it was before.

    Models, views and options of a session that is already open stay; a session that is not is
    opened and closed again.
    """
    gmsh = library()
    started = not gmsh.isInitialized()
    if started:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    current, views = gmsh.model.getCurrent(), set(gmsh.view.getTags())
    wanted = {"General.Terminal": 0.0, **options}
    before = {key: gmsh.option.getNumber(key) for key in wanted}
    taken = gmsh.model.list()
    while name in taken:
        name += "_"
    try:
        for key, value in wanted.items():
            gmsh.option.setNumber(key, value)
        gmsh.model.add(name)
        yield gmsh
    finally:
        if name in gmsh.model.list():
            gmsh.model.setCurrent(name)
            gmsh.model.remove()
        for view in set(gmsh.view.getTags()) - views:
            gmsh.view.remove(view)
        if gmsh.model.getCurrent() != current:
            gmsh.model.setCurrent(current)
        for key, value in before.items():
            gmsh.option.setNumber(key, value)
        if started:
            gmsh.finalize()


def only_surface(gmsh: Any, tag: int | None) -> int:
    """``tag`` if the current model has such a surface, or its only one."""
    surfaces = [number for _, number in gmsh.model.getEntities(2)]
    if tag is None and len(surfaces) == 1:
        return int(surfaces[0])
    if tag is None:
        raise InputError(f"The model has {len(surfaces)} surfaces: say which one with tag=.")
    if tag not in surfaces:
        raise InputError(f"The model has no surface {tag}: its surfaces are {surfaces}.")
    return int(tag)


def surface_mesh(gmsh: Any, tag: int | None) -> tuple[Array, IntArray]:
    """Points (n, 3) and triangles (m, 3) of a surface, or of all surfaces where ``tag`` is None."""
    kinds, _, connections = gmsh.model.mesh.getElements(2, -1 if tag is None else tag)
    parts = [
        np.asarray(nodes, np.int64).reshape(-1, size)[:, SPLITS[FACES[kind]]].reshape(-1, 3)
        for kind, nodes in zip(kinds, connections, strict=True)
        if kind in FACES
        for size in [gmsh.model.mesh.getElementProperties(kind)[3]]
    ]
    if not parts:
        where = "The model" if tag is None else f"Surface {tag}"
        raise InputError(f"{where} has no triangles: mesh it first, or give another one.")
    triangles = np.concatenate(parts)
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    numbers = np.asarray(numbers, np.int64)
    order = np.argsort(numbers)
    used = np.unique(triangles)
    rows = order[np.searchsorted(numbers[order], used)]
    points = np.asarray(coordinates, np.float64).reshape(-1, 3)[rows]
    return points, np.searchsorted(used, triangles)


def curves_of(gmsh: Any, surface: int, chords: float) -> list[Curve]:
    """The boundary curves; curved ones in chords that stay near, ``chords`` in surface sizes."""
    box = np.array(gmsh.model.getBoundingBox(2, surface))
    sagitta = chords * float((box[3:] - box[:3]).max())
    found = []
    for tag in boundary_tags(gmsh, surface):
        kind = gmsh.model.getType(1, tag)
        ends = tuple(int(end) for _, end in gmsh.model.getBoundary([(1, tag)], combined=False))
        loose = np.zeros((0, 3))
        if kind == "Discrete curve":
            pieces = _elements_of(gmsh, tag)
            if not ends:
                loose = open_ends(pieces)
        else:
            start = [gmsh.model.getValue(0, end, []) for end in ends]
            low, high = (float(v[0]) for v in gmsh.model.getParametrizationBounds(1, tag))
            line = _chords(gmsh, tag, np.linspace(low, high, 2 if kind == "Line" else 9), sagitta)
            if start:
                forward = np.linalg.norm(line[0] - start[0]) <= np.linalg.norm(line[0] - start[-1])
                line[0], line[-1] = (start[0], start[-1]) if forward else (start[-1], start[0])
            pieces = np.stack([line[:-1], line[1:]], 1)
        found.append(Curve(tag, kind, pieces, ends, loose))
    return found


def plane_domain(
    gmsh: Any, surface: int, curves: Sequence[Curve]
) -> tuple[shapely.Geometry, float]:
    """The polygon that a surface parallel to the xy plane covers, and its height."""
    if curves:
        places = np.concatenate([curve.pieces for curve in curves])
        domain = shapely.build_area(shapely.multilinestrings([p[:, :2] for p in places]))
    else:
        points, triangles = surface_mesh(gmsh, surface)
        domain, places = Surface(points, triangles, up="z").outline(0.0), points[triangles]
    height = float(places[0, 0, 2])
    if np.abs(places[..., 2] - height).max() > SAME * float(np.ptp(places, axis=(0, 1)).max()):
        raise InputError(f"Surface {surface} is not parallel to the xy plane: rotate the model.")
    return domain, height


def boundary_tags(gmsh: Any, surface: int) -> list[int]:
    """The curves around a surface.

    A discrete surface from a file without topology (Gmsh's format 2.2, STL) does not know them:
    they are those whose lines all are border edges of its mesh.
    """
    known = [abs(tag) for _, tag in gmsh.model.getBoundary([(2, surface)], combined=False)]
    twice = [tag for tag in known if known.count(tag) > 1]
    if twice:
        raise InputError(f"Surface {surface} lies on both sides of curve {twice[0]}: cut it there.")
    if known or gmsh.model.getType(2, surface) != "Discrete surface":
        return known
    _, nodes = gmsh.model.mesh.getElementsByType(TRIANGLE, surface)
    outer = border_edges(np.asarray(nodes, np.int64).reshape(-1, 3))
    border = {frozenset(edge) for edge in outer.tolist()}
    for _, tag in gmsh.model.getEntities(1):
        _, ends = gmsh.model.mesh.getElementsByType(LINE, tag)
        lines = {frozenset(edge) for edge in np.asarray(ends, np.int64).reshape(-1, 2).tolist()}
        if lines and lines <= border:
            known.append(int(tag))
    return known


def open_ends(pieces: Array) -> Array:
    """(k, 3) places where only one of the pieces (s, 2, 3) ends."""
    places, count = np.unique(pieces.reshape(-1, 3), axis=0, return_counts=True)
    return places[count == 1]


def _elements_of(gmsh: Any, tag: int) -> Array:
    _, nodes = gmsh.model.mesh.getElementsByType(LINE, tag)
    if len(nodes) == 0:
        raise InputError(f"Curve {tag} has no line elements: the surface's border is not known.")
    place = {int(n): gmsh.model.mesh.getNode(int(n))[0] for n in np.unique(nodes)}
    return np.array([place[int(n)] for n in nodes]).reshape(-1, 2, 3)


def _chords(gmsh: Any, tag: int, at: Array, sagitta: float) -> Array:
    """Points (s, 3) along a curve; each chord's middle is within ``sagitta`` of the curve."""

    def value(t: Array) -> Array:
        return np.asarray(gmsh.model.getValue(1, tag, t)).reshape(-1, 3)

    if len(at) == 2:
        return value(at)
    for _ in range(DEEPEST):
        ends, middle = value(at), 0.5 * (at[:-1] + at[1:])
        away = np.linalg.norm(value(middle) - 0.5 * (ends[:-1] + ends[1:]), axis=1)
        if (away <= sagitta).all():
            break
        at = np.sort(np.concatenate([at, middle[away > sagitta]]))
    return value(at)


def replace_mesh(gmsh: Any, surface: int, curves: Sequence[Curve], patch: Patch) -> None:
    """Exchange the nodes and elements of a surface and of its boundary curves.

    Entities, physical groups and the nodes of points stay.
    """
    mesh = gmsh.model.mesh
    mesh.clear([(2, surface)])
    if curves:
        mesh.clear([(1, curve.tag) for curve in curves])
    next_node, next_element = int(mesh.getMaxNodeTag()) + 1, int(mesh.getMaxElementTag()) + 1
    number = np.zeros(len(patch.points), np.int64)
    for point, vertex in patch.corners.items():
        present, place, _ = mesh.getNodes(0, point)
        where = patch.points[vertex]
        if len(present) == 0:
            mesh.addNodes(0, point, [next_node], where)
            mesh.addElementsByType(point, POINT, [next_element], [next_node])
            number[vertex] = next_node
            next_node, next_element = next_node + 1, next_element + 1
        else:
            number[vertex] = int(present[0])
            if not np.array_equal(place, where):
                mesh.setNode(int(present[0]), where, [])
                gmsh.model.setCoordinates(point, *where)
    for (dimension, tag), vertices in patch.places.items():
        number[vertices] = np.arange(next_node, next_node + len(vertices))
        next_node += len(vertices)
        flat = patch.points[vertices].ravel()
        entity = surface if dimension == 2 else tag
        known = gmsh.model.getType(dimension, entity)
        parameters = []
        if not known.startswith("Discrete") and len(vertices):
            parameters = gmsh.model.getParametrization(dimension, entity, flat)
        mesh.addNodes(dimension, entity, number[vertices], flat, parameters)
    for tag in (curve.tag for curve in curves):
        mine = patch.edges[patch.owners == tag]
        numbers = np.arange(next_element, next_element + len(mine))
        mesh.addElementsByType(tag, LINE, numbers, number[mine].ravel())
        next_element += len(mine)
    numbers = np.arange(next_element, next_element + len(patch.triangles))
    mesh.addElementsByType(surface, TRIANGLE, numbers, number[patch.triangles].ravel())
