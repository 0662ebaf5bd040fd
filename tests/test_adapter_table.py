"""Adapters by suffix and by type, one table for all of them, and how others join it."""

import importlib.util
import pathlib
import subprocess
import sys
import textwrap
from importlib.metadata import entry_points

import meshio
import numpy as np
import pymeshlab
import pytest
import pyvista
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh.formats import GROUP, Format, families, family_of, formats

POINTS = np.array([[x, y, x * y] for y in np.linspace(0, 1, 9) for x in np.linspace(0, 1, 9)])
CELLS = np.array([[i, i + 1, i + 10, i + 9] for i in range(71) if i % 9 < 8])
TRIANGLES = np.vstack([CELLS[:, [0, 1, 2]], CELLS[:, [0, 2, 3]]])


def of_trimesh():
    return trimesh.Trimesh(POINTS, TRIANGLES, process=False)


def of_meshio():
    return meshio.Mesh(POINTS, [("triangle", TRIANGLES)])


def of_pymeshlab():
    return pymeshlab.Mesh(POINTS, TRIANGLES)


def of_pyvista():
    return pyvista.PolyData.from_regular_faces(POINTS, TRIANGLES)


OBJECTS = [of_trimesh, of_meshio, of_pymeshlab, of_pyvista]


def test_every_declared_adapter_is_whole_and_answers_for_its_own():
    declared = sorted(entry_points(group=GROUP), key=lambda entry: entry.name)
    assert [entry.load() for entry in declared] == families()
    for entry in declared:
        family = entry.load()
        assert isinstance(family, Format)
        assert family.suffixes or family.types
        assert all(suffix == suffix.lower() and suffix[0] == "." for suffix in family.suffixes)
        assert (family.read is not None) == bool(family.suffixes) or family.write is not None
        for name in family.types:
            package, _, kind = name.rpartition(".")
            if importlib.util.find_spec(package.partition(".")[0]):
                assert isinstance(getattr(importlib.import_module(package), kind), type)
        if family.types:
            assert family.to_field is not None


@pytest.mark.parametrize("make", OBJECTS)
def test_objects_are_known_by_their_type(make):
    thing = make()
    field = equimesh_adapters.load(thing)
    assert isinstance(field, equimesh.Surface)
    x, y, z = POINTS.T
    np.testing.assert_allclose(field.value(x, y), z, atol=1e-12)
    made = equimesh_adapters.remesh(thing, 0.02)
    assert type(made) is type(thing)
    again = equimesh_adapters.load(made)
    assert len(again.triangles) < len(TRIANGLES)
    assert equimesh.profile(again.points, again.triangles, field).bound <= 0.02 * (1 + 1e-9)


@pytest.mark.parametrize("make", OBJECTS)
def test_up_goes_along(make):
    """The saddle is a graph in this direction too, and other heights come of it."""
    field = equimesh_adapters.load(make(), up=(0.1, 0.2, 1))
    assert not np.allclose(np.sort(field.points[:, 2]), np.sort(POINTS[:, 2]))
    made = equimesh_adapters.remesh(make(), 0.02, up=(0.1, 0.2, 1))
    again = equimesh_adapters.load(made, up=(0.1, 0.2, 1))
    assert equimesh.profile(again.points, again.triangles, field).bound <= 0.02 * (1 + 1e-9)


def test_subclasses_are_known_by_their_base():
    class Terrain(trimesh.Trimesh):
        pass

    terrain = Terrain(POINTS, TRIANGLES, process=False)
    assert family_of(terrain) is family_of(of_trimesh())


def test_files_are_known_by_their_suffix(tmp_path):
    result = equimesh_adapters.remesh(of_file(tmp_path / "a.ply"), 0.02)
    assert isinstance(result, equimesh.Result)
    equimesh_adapters.save(tmp_path / "b.OBJ", result)
    points, triangles = equimesh_adapters.load_mesh(str(tmp_path / "b.OBJ"))
    assert len(triangles) == len(result.triangles)
    assert len(points) == len(result.points)


def test_a_file_is_remeshed_in_its_own_coordinates(tmp_path):
    turned = of_trimesh()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    turned.export(tmp_path / "a.ply")
    result = equimesh_adapters.remesh(tmp_path / "a.ply", 0.02, up="x")
    low, high = turned.bounds
    np.testing.assert_allclose(result.points.min(axis=0), low, atol=1e-9)
    np.testing.assert_allclose(result.points.max(axis=0), high, atol=1e-9)


def of_file(path):
    of_trimesh().export(path)
    return path


def test_what_is_not_known_is_refused_in_one_sentence(tmp_path):
    for wrong in (object(), 3.5, [1, 2], None):
        with pytest.raises(InputError, match=r"no known type: use one of .*trimesh\.Trimesh"):
            equimesh_adapters.load(wrong)
        with pytest.raises(InputError, match="no known type"):
            equimesh_adapters.remesh(wrong, 0.1)
    with pytest.raises(InputError, match=r"\.ply"):
        equimesh_adapters.load(of_file(tmp_path / "a.stl").rename(tmp_path / "a.unheard"))
    with pytest.raises(InputError, match="leave it out for files"):
        equimesh_adapters.load(of_file(tmp_path / "a.ply"), scalars="dem")


@given(st.sampled_from(sorted(formats())), st.booleans())
def test_suffixes_lead_to_one_adapter_whatever_their_case(suffix, upper):
    family = formats()[suffix]
    assert suffix in family.suffixes
    path = pathlib.Path("x" + (suffix.upper() if upper else suffix))
    if family.write is None:
        with pytest.raises(InputError, match="is not known here"):
            equimesh.formats.writer(path)
    else:
        assert equimesh.formats.writer(path) is family.write


THIRD_PARTY = """
    import numpy as np
    from pathlib import Path
    import equimesh
    from equimesh.formats import Format, TriangleMesh

    class Patch:
        def __init__(self, points, triangles, name):
            self.points, self.triangles, self.name = points, triangles, name

    def read(path):
        numbers = np.array(path.read_text().split(), float)
        count = int(numbers[0])
        points = numbers[1 : 1 + 3 * count].reshape(-1, 3)
        return TriangleMesh(points, numbers[1 + 3 * count :].reshape(-1, 3).astype(int))

    def write(path, result):
        rows = [len(result.points), *result.points.ravel(), *result.triangles.ravel()]
        path.write_text(" ".join(map(repr, map(float, rows))))

    def to_field(patch, *, up=None):
        return equimesh.Surface(patch.points, patch.triangles, up=up)

    def remesh(patch, tol=None, **options):
        result = equimesh.remesh(to_field(patch), tol, **options)
        return Patch(result.points, result.triangles, patch.name)

    FORMAT = Format((".patch",), read, write,
                    types=("patchwork.Patch",), to_field=to_field, remesh=remesh)
"""


def distribution(folder, code=THIRD_PARTY):
    """What pip would leave behind of a distribution ``patchwork``."""
    (folder / "patchwork").mkdir()
    (folder / "patchwork/__init__.py").write_text("from patchwork.kinds import FORMAT, Patch\n")
    (folder / "patchwork/kinds.py").write_text(textwrap.dedent(code))
    about = folder / "patchwork-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: patchwork\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[equimesh.adapters]\npatchwork = patchwork:FORMAT\n")


def test_a_third_party_joins_the_table_by_an_entry_point(tmp_path, monkeypatch):
    distribution(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    import patchwork

    try:
        patch = patchwork.Patch(POINTS, TRIANGLES, "meadow")
        made = equimesh_adapters.remesh(patch, 0.02)
        assert isinstance(made, patchwork.Patch)
        assert made.name == "meadow"
        result = equimesh.remesh(equimesh_adapters.load(patch), 0.02)
        equimesh_adapters.save(tmp_path / "a.patch", result)
        points, triangles = equimesh_adapters.load_mesh(tmp_path / "a.patch")
        np.testing.assert_array_equal(points, result.points)
        np.testing.assert_array_equal(triangles, result.triangles)
        with pytest.raises(InputError, match=r"patchwork\.Patch"):
            family_of(3)
    finally:
        for name in [name for name in sys.modules if name.startswith("patchwork")]:
            del sys.modules[name]


def test_the_command_line_uses_the_same_table(tmp_path):
    distribution(tmp_path)
    of_file(tmp_path / "a.ply")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        f"sys.argv = ['equimesh', 'remesh', {str(tmp_path / 'a.ply')!r}, "
        f"{str(tmp_path / 'a.patch')!r}, '--tol', '0.02']\n"
        "from equimesh.cli import main; main()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    assert (tmp_path / "a.patch").stat().st_size > 100


def test_a_broken_third_party_is_left_out_with_a_warning(tmp_path, monkeypatch):
    distribution(tmp_path, "import a_module_that_nobody_has")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.warns(UserWarning, match="patchwork is left out.*a_module_that_nobody_has"):
        assert ".ply" in formats()


def test_objects_are_recognised_without_importing_any_library():
    code = (
        "import sys\n"
        "import equimesh_adapters\n"
        "try: equimesh_adapters.load(3)\n"
        "except equimesh_adapters.load.__globals__['InputError']: pass\n"
        "tools = {'trimesh', 'meshio', 'pymeshlab', 'pyvista', 'gmsh', 'rasterio', 'xarray'}\n"
        "print(*sorted(tools & set(sys.modules)))\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == ""


def test_the_core_imports_without_any_tool():
    code = (
        "import sys\n"
        "for name in ('trimesh', 'meshio', 'pymeshlab', 'pyvista', 'gmsh', 'rasterio', 'xarray',\n"
        "             'matplotlib', 'h5py', 'vtk', 'equimesh_adapters'):\n"
        "    sys.modules[name] = None\n"
        "import equimesh\n"
        "print(equimesh.remesh('x*y', tol=0.1, domain=(0, 0, 1, 1)).status.ok)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout == "True\n"
