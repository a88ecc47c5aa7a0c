# SPDX-License-Identifier: GPL-3.0-or-later
"""The page on scripts lists the values of arguments, and its lines load presets."""

import re
from pathlib import Path

import bpy
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "scripts.md").read_text(encoding="utf-8").partition("## Values")[2]


def listed(argument: str) -> set[str]:
    """Return the values in the row of an argument."""
    [values] = re.findall(rf"^\| {re.escape(argument)} \| (.*) \|$", PAGE, re.MULTILINE)
    return set(re.findall(r'"(\w+)"', values))


def shipped(kind: str) -> set[str]:
    """Return the names of the presets of a kind, "land" or "layers"."""
    files = (ROOT / "operators" / "presets" / "adaptive_terrain" / kind).iterdir()
    return {file.stem for file in files if file.suffix in (".py", ".json")}


def test_the_page_lists_all_values(scene):
    for operator, name, row in (
        (bpy.ops.mesh.adaptive_terrain_add, "land", "`adaptive_terrain_add(land=)`"),
        (bpy.ops.adaptive_terrain.scatter_add, "kind", "`scatter_add(kind=)`"),
    ):
        items = operator.get_rna_type().properties[name].enum_items
        assert listed(row) == {item.identifier for item in items}
    assert listed("`land_add(effect=)`") == set(HEIGHT_OPERATORS)
    assert listed("presets of land") == shipped("land") and listed("presets of layers") == shipped("layers")


def test_the_page_names_all_arguments_of_a_new_terrain(scene):
    arguments = set(bpy.ops.mesh.adaptive_terrain_add.get_rna_type().properties.keys()) - {"rna_type"}
    [row] = re.findall(r"^\| its further arguments .*$", PAGE, re.MULTILINE)
    assert set(re.findall(r"`(\w+)=`", row)) | {"land"} == arguments


def test_the_lines_of_the_page_load_presets(scene, add_terrain):
    terrain = add_terrain()
    bpy.context.view_layer.objects.active = terrain
    [lines] = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(lines, {"bpy": bpy})
    settings = terrain.adaptive_terrain
    assert {entry.effect for entry in settings.land.entries} >= {"rivers", "scree", "snow"}
    assert [layer.name for layer in settings.layers] == ["Meadow", "Forest", "Scree", "Rock", "Stream", "Snow"]
    assert terrain.active_material is not None
