"""trimesh in, trimesh out: attributes, colours, metadata and bodies come along."""

import hashlib
import pickle
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.errors import InputError
from equimesh_adapters.trimesh import from_result, profile, remesh, to_field


def sheet(n=12, height=lambda x, y: x * y, **options):
    """(n + 1)^2 vertices over the unit square, 2 n^2 faces wound upwards, nothing merged."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.vstack([np.column_stack([i, i + 1, i + n + 2]),
                       np.column_stack([i, i + n + 2, i + n + 1])])  # fmt: skip
    points = np.column_stack([x, y, height(x, y)])
    return trimesh.Trimesh(points, faces, process=False, **options)


def fingerprint(mesh):
    """Of every array and all metadata that a trimesh owns."""
    arrays = [mesh.vertices, mesh.faces, mesh.metadata, mesh.visual.kind]
    arrays += [sorted(mesh.vertex_attributes.items()), sorted(mesh.face_attributes.items())]
    if mesh.visual.kind == "texture":
        arrays += [mesh.visual.uv]
    elif mesh.visual.kind:
        arrays += [getattr(mesh.visual, f"{mesh.visual.kind}_colors")]
    plain = [a.tolist() if isinstance(a, np.ndarray) else a for a in arrays]
    return hashlib.sha256(pickle.dumps(repr(plain))).hexdigest()


def rich(**options):
    mesh = sheet(**options)
    x, y = mesh.vertices[:, :2].T
    mesh.vertex_attributes["slope"] = 2 * x - y + 0.25
    mesh.vertex_attributes["flow"] = np.column_stack([x + y, x - 3 * y]).astype(np.float32)
    mesh.vertex_attributes["label"] = (x > 0.5).astype(np.int32) * 7
    mesh.vertex_attributes["name"] = np.where(y > 0.5, "north", "south")
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    mesh.face_attributes["zone"] = (middle[:, 0] > 0.5).astype(np.int16)
    mesh.face_attributes["weight"] = np.floor(3 * middle[:, 1])
    mesh.metadata["source"] = {"file": "a.tif", "rows": [1, 2]}
    mesh.units = "meters"
    return mesh


def test_linear_attributes_come_back_exactly_and_names_all():
    mesh = rich()
    before = fingerprint(mesh)
    made = remesh(mesh, tol=0.01)
    assert fingerprint(mesh) == before
    assert type(made) is trimesh.Trimesh
    assert len(made.faces) < len(mesh.faces)
    assert set(made.vertex_attributes) == set(mesh.vertex_attributes)
    assert set(made.face_attributes) == {*mesh.face_attributes, "error"}
    x, y = made.vertices[:, :2].T
    found = made.vertex_attributes
    np.testing.assert_allclose(found["slope"], 2 * x - y + 0.25, atol=1e-14)
    np.testing.assert_allclose(found["flow"], np.column_stack([x + y, x - 3 * y]), atol=1e-6)
    assert found["flow"].dtype == np.float32
    # Nearest corner: right wherever a vertex is not within one cell of the line between the labels.
    far = np.abs(x - 0.5) > 1 / 12
    np.testing.assert_array_equal(found["label"][far], 7 * (x[far] > 0.5))
    far = np.abs(y - 0.5) > 1 / 12
    np.testing.assert_array_equal(found["name"][far], np.where(y[far] > 0.5, "north", "south"))
    assert found["label"].dtype == np.int32
    middle = made.vertices[made.faces].mean(axis=1)
    np.testing.assert_array_equal(made.face_attributes["zone"], middle[:, 0] > 0.5)
    np.testing.assert_array_equal(made.face_attributes["weight"], np.floor(3 * middle[:, 1]))
    assert made.face_attributes["zone"].dtype == np.int16
    assert made.metadata == mesh.metadata
    assert made.units == "meters"
    assert made.metadata["source"] is not mesh.metadata["source"]


@settings(max_examples=8)
@given(
    st.integers(0, 10**6), st.floats(0.1, 2.0),
    st.sampled_from([(1, 2, 3), (0, 1, 0), (0, 0, -1), (1, -1, 0)]),
)  # fmt: skip
def test_turned_surfaces_keep_winding_values_and_tolerance(seed, size, up):
    """Any rotation and winding: an attribute linear in space stays so, and normals look back."""
    rng = np.random.default_rng(seed)
    mesh = sheet(8, lambda x, y: 0.2 * x * y * size)
    if seed % 2:
        mesh.faces = mesh.faces[:, ::-1]
    normal = mesh.face_normals.mean(axis=0)
    mesh.vertex_attributes["height"] = mesh.vertices[:, 2].copy()
    turn = trimesh.geometry.align_vectors([0, 0, 1], up)
    turn[:3, 3] = rng.normal(size=3) * 100
    mesh.apply_transform(turn)
    made = remesh(mesh, tol=0.01, up=up)
    assert profile(made, mesh, up=up).bound <= 0.01 * (1 + 1e-9)
    new_normal = np.average(made.face_normals, axis=0, weights=made.area_faces)
    assert new_normal @ (turn[:3, :3] @ normal) > 0.5
    back = trimesh.transform_points(made.vertices, np.linalg.inv(turn))
    np.testing.assert_allclose(made.vertex_attributes["height"], back[:, 2], atol=1e-9)


def test_colours_of_vertices_are_blended_and_those_of_faces_taken_from_the_nearest():
    mesh = sheet()
    x, y = mesh.vertices[:, :2].T
    exact = np.column_stack([240 * x, 240 * y, 0 * x, 255 + 0 * x])
    mesh.visual.vertex_colors = np.rint(exact).astype(np.uint8)
    made = remesh(mesh, tol=0.02)
    x, y = made.vertices[:, :2].T
    found = made.visual.vertex_colors.astype(float)
    assert made.visual.kind == "vertex"
    assert np.abs(found - np.column_stack([240 * x, 240 * y, 0 * x, 255 + 0 * x])).max() <= 1.0
    mesh = sheet()
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    red, blue = [255, 0, 0, 255], [0, 0, 255, 128]
    mesh.visual.face_colors = np.where(middle[:, :1] > 0.5, red, blue).astype(np.uint8)
    before = fingerprint(mesh)
    made = remesh(mesh, tol=0.02)
    assert fingerprint(mesh) == before
    middle = made.vertices[made.faces].mean(axis=1)
    assert made.visual.kind == "face"
    np.testing.assert_array_equal(made.visual.face_colors, np.where(middle[:, :1] > 0.5, red, blue))


def test_texture_coordinates_and_material_come_along():
    mesh = sheet()
    material = trimesh.visual.material.PBRMaterial(name="rock", roughnessFactor=0.5)
    uv = mesh.vertices[:, :2] * [0.5, 1.0] + 0.1
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    before = fingerprint(mesh)
    made = remesh(mesh, tol=0.02)
    assert fingerprint(mesh) == before
    np.testing.assert_allclose(made.visual.uv, made.vertices[:, :2] * [0.5, 1.0] + 0.1, atol=1e-14)
    assert made.visual.material.name == "rock"
    assert made.visual.material is not material


def test_results_and_fields_of_a_trimesh():
    mesh = sheet()
    field = to_field(mesh)
    result = equimesh.remesh(field, tol=0.02)
    made = from_result(result)
    np.testing.assert_array_equal(made.vertices, result.points)
    np.testing.assert_array_equal(made.faces, result.triangles)
    np.testing.assert_array_equal(made.face_attributes["error"], result.profile.errors)
    again = to_field(made)
    np.testing.assert_array_equal(again.points, result.points)
    direct = remesh(mesh, tol=0.02)
    np.testing.assert_array_equal(direct.vertices, made.vertices)
    np.testing.assert_array_equal(direct.faces, made.faces)


def test_vertices_are_never_merged():
    """A soup: every face has its own corners, and the result is sewn without another's doing."""
    mesh = sheet()
    soup = trimesh.Trimesh(
        mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        process=False,
    )  # fmt: skip
    made = remesh(soup, tol=0.02)
    assert len(soup.vertices) == 3 * len(mesh.faces)
    whole = remesh(mesh, tol=0.02)
    assert len(made.faces) == len(whole.faces)
    assert made.area == pytest.approx(whole.area)


def layers():
    """Two sheets over one another and a wall beside them: no graph together, each one by itself."""
    low = sheet(8, lambda x, y: 0.3 * x * y)
    high = sheet(6, lambda x, y: 2 + 0.3 * np.sin(3 * x))
    wall = sheet(6, lambda x, y: 0.3 * x * x)
    wall.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0], [0, 5, 0]))
    for number, part in enumerate([low, high, wall]):
        part.face_attributes["part"] = np.full(len(part.faces), number)
        part.vertex_attributes["part"] = np.full(len(part.vertices), float(number))
    return trimesh.util.concatenate([low, high, wall])


def test_bodies_are_meshed_one_by_one_in_order():
    mesh = layers()
    with pytest.raises(InputError, match="is no graph"):
        to_field(mesh)
    before = fingerprint(mesh)
    made = remesh(mesh, tol=0.01)
    assert fingerprint(mesh) == before
    assert made.body_count == 3
    part = made.face_attributes["part"]
    assert (np.diff(part) >= 0).all()
    assert set(part) == {0, 1, 2}
    np.testing.assert_array_equal(made.vertex_attributes["part"][made.faces].mean(axis=1), part)
    measured = profile(made, mesh)
    assert measured.bound <= 0.01 * (1 + 1e-9)
    np.testing.assert_allclose(measured.errors, made.face_attributes["error"], atol=1e-12)
    again = remesh(mesh, tol=0.01)
    np.testing.assert_array_equal(again.vertices, made.vertices)
    np.testing.assert_array_equal(again.faces, made.faces)


def test_a_share_means_the_largest_range_and_a_target_is_divided():
    mesh = layers()
    np.testing.assert_array_equal(remesh(mesh, tol="5%").faces, remesh(mesh, tol=0.05 * 0.3).faces)
    assert 6 <= len(remesh(mesh, target=40).faces) <= 40


def test_what_is_no_graph_is_refused_with_the_share_and_a_hint():
    mesh = sheet(4)
    mesh.vertices[12] = [0.9, 0.5, 0.3]  # beyond its neighbour: some triangles turn over
    with pytest.raises(InputError) as caught:
        remesh(mesh, tol=0.1)
    text = str(caught.value)
    assert "%" in text
    assert "up=" in text
    assert "split" in text
    with pytest.raises(InputError, match=r"(?s)%.*up=.*split"):
        remesh(trimesh.creation.icosphere(subdivisions=2), tol=0.1)
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.apply_translation([5, 0, 0])
    with pytest.raises(InputError, match=r"Body 2 of 2.*%.*up=.*split"):
        remesh(trimesh.util.concatenate([sheet(3), ball]), tol=0.1)


def test_profile_of_any_mesh():
    mesh, flat = sheet(16), trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0.0]], [[0, 1, 2], [0, 2, 3]], process=False
    )  # fmt: skip
    assert profile(flat, "x*y").max == pytest.approx(0.25)
    assert profile(flat, mesh).max == pytest.approx(0.25)
    assert profile(mesh, mesh).max <= 1e-14
    flat.faces = flat.faces[::-1, ::-1]
    assert profile(flat, mesh).errors == pytest.approx([0.25, 0.25])


def test_the_tolerance_must_be_met_and_options_are_passed_on():
    with pytest.raises(InputError, match="either tol= or target="):
        remesh(sheet(3))
    with pytest.raises(InputError, match="effort"):
        remesh(sheet(3), tol=0.1, effort="great")
    with pytest.raises(InputError, match="no triangles"):
        remesh(trimesh.Trimesh(process=False), tol=0.1)
    holed = sheet(3)
    holed.vertices[5] = np.nan
    with pytest.raises(InputError, match="NaN"):
        remesh(holed, tol=0.1)


def test_the_core_and_the_adapter_import_without_trimesh():
    code = (
        "import sys; sys.modules['trimesh'] = None\n"
        "import equimesh, equimesh_adapters.trimesh as adapter\n"
        "result = equimesh.remesh('x*y', tol=0.1, domain=(0, 0, 1, 1))\n"
        "try: adapter.from_result(result)\n"
        "except equimesh.InputError as error: print(error)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout == "trimesh is not installed: pip install trimesh.\n"
