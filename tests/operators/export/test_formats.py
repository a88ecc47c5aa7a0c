# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of exported mesh formats, and formats and frames as text."""

from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.export import blender_exporters, formats
from adaptive_terrain.operators.export.formats import FORMATS, format_of, needs_blender, parse_formats


@pytest.mark.parametrize("name", FORMATS)
def test_every_function_of_a_format_exists(name):
    form = FORMATS[name]
    for function in filter(None, (form.write, form.export, form.count, form.finish)):
        assert callable(resolve_name(f"{formats.__package__}.{function}"))
    assert bool(form.export) == bool(form.count) == (name in ("ply", "obj", "glb", "stl", "usda"))


def test_formats_are_read_from_text_and_suffixes():
    assert parse_formats("PLY, npz,ply") == ("ply", "npz") and format_of(Path("a.B.GLB")) is FORMATS["glb"]
    assert [needs_blender([name]) for name in FORMATS] == [False, *[True] * 6]
    for text, wrong in (("npz,", "''"), ("fbx", "'fbx'")):
        with pytest.raises(TerrainError, match=f"format {wrong} is unknown") as caught:
            parse_formats(text)
        assert caught.value.expected == "one of npz, ply, obj, glb, stl, usda, blend"
    for name in ("a", "a.fbx", "ply"):
        with pytest.raises(TerrainError, match=f"'{name}' has no known format; expected one of npz, ply"):
            format_of(Path(name))


def test_a_new_format_needs_an_entry_and_a_writer(scene, add_terrain, tmp_path, monkeypatch):
    terrain = add_terrain("Hills")
    monkeypatch.setitem(FORMATS, "mesh", replace(FORMATS["ply"], export="blender_exporters.export_mesh"))
    monkeypatch.setattr(blender_exporters, "export_mesh", blender_exporters.export_ply, raising=False)
    assert bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "hills.mesh")) == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "hills.ply")) == {"FINISHED"}
    assert (tmp_path / "hills.mesh").read_bytes() == (tmp_path / "hills.ply").read_bytes() and terrain.data.polygons
