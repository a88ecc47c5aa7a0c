# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a surface in Blender and in files, and invalid attributes."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.mesh.archive import write_npz
from adaptive_terrain.cbt_terrain.mesh.attributes import DOMAINS, TYPES, Attribute
from adaptive_terrain.operators.bridge.cleanup import Cleanup, clean_up
from adaptive_terrain.operators.bridge.writer import write_mesh
from adaptive_terrain.operators.export.blender_exporters import export_glb, export_ply, only_selected
from mesh_files import read_glb_attributes, read_ply_fields

# The property with the numbers, by Blender's data type, if it is not "value".
PROPERTY = {"FLOAT2": "vector", "FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}


def every_kind(surface) -> dict[str, Attribute]:
    """Return an attribute of each type in each domain, with different values by element and column."""
    attributes = {}
    for (dtype, width), (data_type, _) in TYPES.items():
        for domain in DOMAINS:
            count = surface.sizes[domain]
            values = np.arange(count * width) % 97 / (1 if dtype != "float32" else 128)
            array = (values % 2 == 0) if dtype == "bool" else values.astype(dtype)
            values = array.reshape(-1, width) if width > 1 else array
            attributes[f"{data_type}_{domain}"] = Attribute(values, domain, "m")
    return attributes


def test_every_type_in_every_domain_comes_into_blender(mesh, grid_surface):
    plain = grid_surface(5, 3)
    made = every_kind(plain)
    write_mesh(mesh, plain.with_attributes(made))
    for name, attribute in made.items():
        found = mesh.attributes[name]
        assert (found.data_type, found.domain) == (name.removesuffix(f"_{found.domain}"), attribute.domain)
        values = np.empty(attribute.array.size, attribute.array.dtype)
        found.data.foreach_get(PROPERTY.get(found.data_type, "value"), values)
        assert np.array_equal(values, attribute.array.ravel()), name
    assert mesh.validate(verbose=True) is False
    write_mesh(mesh, plain)
    assert not made.keys() & set(mesh.attributes.keys()), "what a surface no longer has goes"


def test_a_cut_keeps_attributes_with_their_triangles_and_places(grid_surface):
    """After a cut, point values still match their positions, and face values their faces."""
    plain = grid_surface(6, 4, lambda x, y: x + 0.1 * y)
    middle = plain.positions[plain.triangles].mean(axis=1)
    of_face = np.floor(middle[:, 0]).astype(np.int32)  # the column of cells that it is in
    surface = plain.with_attributes(
        {
            "x": Attribute(plain.positions[:, 0].copy(), "POINT"),
            "column": Attribute(of_face, "FACE"),
            "colour": Attribute(np.repeat(of_face, 3).astype(np.float32)[:, None] * np.ones(4, np.float32), "CORNER"),
        }
    )
    left = clean_up(surface, Cleanup(below=2.5))
    made = {name: attribute.array for name, attribute in left.attributes.items()}
    assert 0 < len(left.triangles) < len(plain.triangles) and left.sizes["POINT"] == len(made["x"])
    np.testing.assert_allclose(made["x"], left.positions[:, 0], atol=1e-5)
    assert (made["column"] == np.floor(left.positions[left.triangles].mean(axis=1)[:, 0])).all()
    assert (made["colour"].reshape(-1, 3, 4) == made["column"][:, None, None]).all()


def test_a_ply_and_an_npz_carry_attributes(empty, grid_surface, tmp_path):
    plain = grid_surface(4, 4)
    wet = np.linspace(0, 1, plain.sizes["POINT"], dtype=np.float32)
    error = np.linspace(3, 4, plain.sizes["FACE"], dtype=np.float32)
    surface = plain.with_attributes({"wetness": Attribute(wet, "POINT"), "error_m": Attribute(error, "FACE", "m")})
    obj = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    empty.collection.objects.link(obj)
    write_mesh(obj.data, surface)
    with only_selected(obj):
        export_ply(obj, str(tmp_path / "a.ply"))
    vertices = read_ply_fields(tmp_path / "a.ply")
    # Blender may write one vertex per corner; the position identifies the original vertex.
    place = vertices["x"].astype(int) + 5 * vertices["y"].astype(int)
    assert len(place) >= len(wet) and np.array_equal(vertices["wetness"], wet[place])
    write_npz(tmp_path / "a.npz", surface, np.zeros(3), {})
    with np.load(tmp_path / "a.npz") as file:
        assert np.array_equal(file["wetness"], wet) and np.array_equal(file["error_m"], error)
        assert '"error_m": {"domain": "FACE", "unit": "m"}' in str(file["info"])


def every_width(surface) -> dict[str, Attribute]:
    """Return point attributes of one to four floats, as effects make them."""
    count = surface.sizes["POINT"]
    values = {f"of_{n}": np.linspace(0, n, count * n, dtype=np.float32).reshape(count, n) for n in (2, 3, 4)}
    values["of_1"] = np.linspace(3, 4, count, dtype=np.float32)
    return {name: Attribute(array, "POINT") for name, array in values.items()}


def test_a_ply_and_a_glb_carry_what_effects_make(empty, grid_surface, tmp_path):
    plain = grid_surface(4, 4)
    made = every_width(plain)
    obj = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    empty.collection.objects.link(obj)
    write_mesh(obj.data, plain.with_attributes(made))
    names = set(obj.data.attributes.keys())
    with only_selected(obj):
        export_ply(obj, str(tmp_path / "a.ply"))
        export_glb(obj, str(tmp_path / "a.glb"))
    assert set(obj.data.attributes.keys()) == names, "names are as they were"
    vertices = read_ply_fields(tmp_path / "a.ply")
    place = vertices["x"].astype(int) + 5 * vertices["y"].astype(int)
    assert np.array_equal(vertices["of_1"], made["of_1"].array[place])
    for name in ("of_2", "of_3"):  # four are a colour, of which Blender's PLY has one
        columns = [vertices[f"{name}_{axis}"] for axis in "xyz"[: int(name[-1])]]
        assert np.array_equal(np.stack(columns, 1), made[name].array[place])
    found = read_glb_attributes(tmp_path / "a.glb")
    x, _, y = found["POSITION"].T  # y is up, north is -z
    place = np.rint(x).astype(int) + 5 * np.rint(-y).astype(int)
    for name, attribute in made.items():
        assert np.array_equal(found["_" + name.upper()], attribute.array[place]), name


@pytest.mark.parametrize(
    ("array", "domain", "message"),
    [
        (np.zeros(25), "POINT", r"'a' is float64 \[25\] of the domain 'POINT'; expected for each element one of"),
        (np.zeros((25, 5), np.float32), "POINT", r"float32 \[25, 5\].*expected for each element"),
        (np.zeros((25, 1), np.float32), "POINT", r"float32 \[25, 1\].*expected for each element"),
        (np.zeros((5, 5, 3), np.float32), "POINT", r"float32 \[5, 5, 3\].*expected for each element"),
        (np.float32(1), "POINT", r"float32 \[\].*expected for each element"),
        (np.zeros(24, np.int32), "POINT", r"int32 \[24\].*expected 25 elements"),
        (np.zeros(25, np.int32), "FACE", r"int32 \[25\].*expected 32 elements"),
        (np.zeros(25, np.int32), "VERTEX", r"'VERTEX'; expected one of POINT, EDGE, FACE, CORNER"),
    ],
)
def test_an_invalid_attribute_gives_one_sentence(grid_surface, array, domain, message):
    with pytest.raises(TerrainError, match=message):
        grid_surface(4, 4).with_attributes({"a": Attribute(array, domain)})


def test_a_name_that_is_taken_is_refused(mesh, grid_surface, tmp_path):
    surface = grid_surface(2, 2)
    values = Attribute(np.zeros(9, np.float32), "POINT")
    with pytest.raises(TerrainError, match="'position'"):
        write_mesh(mesh, surface.with_attributes({"position": values}))
    with pytest.raises(TerrainError, match="'edges', which is an entry of every exported file"):
        write_npz(tmp_path / "a.npz", surface.with_attributes({"edges": values}), np.zeros(3), {})
