# SPDX-License-Identifier: GPL-3.0-or-later
"""What programs import from the package itself, under any name of the package, and what that costs those who do not."""

import subprocess
import sys
from pathlib import Path

import adaptive_terrain
import pytest

ROOT = Path(__file__).resolve().parents[1]
# As Blender loads an extension: by its folder, as a part of `bl_ext.REPOSITORY`, without bpy here.
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


def test_names_come_when_they_are_asked_for_also_as_an_extension():
    command = [sys.executable, "-c", AS_EXTENSION, str(ROOT / "__init__.py"), str(ROOT)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_every_name_is_there_documented_and_listed():
    names = "Terrain", "View", "Criterion", "open_store", "import_source", "ImportSettings", "bake"
    queries = "ground_at", "profile", "pick", "nearest", "box_range", "viewshed"
    for name in (*names, *queries, "Scatter", "scatter_points"):
        found = getattr(adaptive_terrain, name)
        assert found.__name__ == name and len(found.__doc__) > 60 and name in dir(adaptive_terrain)
    with pytest.raises(AttributeError, match="'adaptive_terrain' has no attribute 'Mountain'"):
        adaptive_terrain.Mountain  # noqa: B018
