# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports from the package itself work under any name of the package and load nothing before their use."""

import subprocess
import sys
from pathlib import Path

import adaptive_terrain
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array

ROOT = Path(__file__).resolve().parents[1]
# Load the package as Blender loads an extension: by its folder, inside `bl_ext.REPOSITORY`, here without bpy.
AS_EXTENSION = """
import importlib.util, sys, types
sys.modules["bpy"] = None
for parent in ("bl_ext", "bl_ext.repo"):
    sys.modules[parent] = types.ModuleType(parent)
    sys.modules[parent].__path__ = []
name = "bl_ext.repo.adaptive_terrain"
spec = importlib.util.spec_from_file_location(name, sys.argv[1], submodule_search_locations=[sys.argv[2]])
package = sys.modules[name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(package)
assert not {"numpy", "warp"} & sys.modules.keys(), "loading the package alone loads no more"
from bl_ext.repo.adaptive_terrain import Criterion, Terrain, View, bake, import_source, open_store
assert Terrain.__module__ == name + ".cbt_terrain.terrain", Terrain.__module__
assert "adaptive_terrain" not in {module.split(".")[0] for module in sys.modules}
"""


def test_names_load_on_first_use_also_in_an_extension():
    command = [sys.executable, "-c", AS_EXTENSION, str(ROOT / "__init__.py"), str(ROOT)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_every_name_is_there_documented_and_listed():
    names = "Terrain", "View", "Criterion", "open_store", "import_source", "ImportSettings", "bake"
    queries = "ground_at", "profile", "pick", "nearest", "box_range", "viewshed"
    files = "write_npz", "read_npz", "measure", "TerrainError"
    for name in (*names, *queries, *files, "Scatter", "scatter_points", "Layer", "Rule"):
        found = getattr(adaptive_terrain, name)
        assert found.__name__ == name and len(found.__doc__) > 60 and name in dir(adaptive_terrain)
        assert name in adaptive_terrain.__all__
    assert sorted(adaptive_terrain.__all__) == sorted(adaptive_terrain._FRONT_DOOR)
    with pytest.raises(AttributeError, match="'adaptive_terrain' has no attribute 'Mountain'"):
        adaptive_terrain.Mountain  # noqa: B018


def test_type_checkers_see_every_name():
    """The imports for type checkers are those of the package's public names."""
    text = (ROOT / "__init__.py").read_text(encoding="utf-8")
    block = text.partition("if TYPE_CHECKING:\n")[2].partition("\n\n")[0]
    found = {}
    for line in block.splitlines():
        _, module, _, names = line.replace(",", "").split(maxsplit=3)
        found |= dict.fromkeys(names.split(), module.removeprefix(".cbt_terrain."))
    assert found == adaptive_terrain._FRONT_DOOR


def test_objects_print_as_one_short_line():
    field = from_array(np.zeros((5, 9), np.float32))
    view, terrain = (
        adaptive_terrain.View.look((0, -9, 9), (0, 0, 0), resolution=(64, 36)),
        adaptive_terrain.Terrain(field),
    )
    assert repr(terrain) == "<Terrain: 9 x 5 samples, no mesh yet>"
    update = terrain.update(adaptive_terrain.Criterion(), view)
    assert repr(field) == "<HeightField: 9 x 5 samples, 0 .. 0 m, bilinear>"
    assert repr(view) == "<View: perspective, 64 x 36 px>"
    assert repr(update).startswith("<Update: 4 triangles, within ") and repr(update).endswith(" px>")
    assert repr(update.surface) == "<Surface: 4 triangles, 6 vertices>"
    assert repr(terrain) == "<Terrain: 9 x 5 samples, 4 triangles>"
    fitted = adaptive_terrain.bake(field, 1, fitted=True)
    assert repr(fitted).startswith("<Fitted: ") and repr(fitted).endswith(" m>")
