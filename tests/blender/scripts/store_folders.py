# SPDX-License-Identifier: GPL-3.0-or-later
"""Make or open terrains with stores in old and new folders: STEP FOLDER.

`old` makes a file of version 0.2.0 with shaped land, whose store is in the extension's user folder. `new` opens it, and
imports in an unsaved and in a saved file.
"""

import json
import sys
from pathlib import Path

import bpy

package = "bl_ext.user_default.adaptive_terrain"
step, folder = sys.argv[sys.argv.index("--") + 1 :]
folder = Path(folder)
location = sys.modules[f"{package}.operators.importing.store_location"]
session = sys.modules[f"{package}.operators.session.session"]
derived_store = sys.modules[f"{package}.cbt_terrain.height_operators.derived_store"]
notices = sys.modules[f"{package}.operators.importing.store_paths"].notices


def add_terrain(side: int):
    terrain = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    bpy.context.scene.collection.objects.link(terrain)
    bpy.context.view_layer.objects.active = terrain
    terrain.adaptive_terrain.enabled, terrain.adaptive_terrain.live = True, False
    terrain.adaptive_terrain.island_size = side
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    return terrain


def state(terrain) -> dict:
    """Return the store and the key of the render's land."""
    session.update_object(terrain, mode="RENDER")
    store = bpy.path.abspath(terrain.adaptive_terrain.store)
    digest = session.record_of(terrain).field.raster.digest
    return {"path": terrain.adaptive_terrain.store, "store": store, "key": digest}


if step == "old":
    location.data_folder = lambda: Path(bpy.utils.extension_path_user(package, path="stores", create=True))
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    terrain = add_terrain(65)
    assert bpy.ops.adaptive_terrain.land_add(effect="scree") == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    result = state(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "old.blend"))
else:
    bpy.ops.wm.open_mainfile(filepath=str(folder / "old.blend"))
    result = {"moved": state(bpy.data.objects["Terrain"]), "shaped_again": derived_store.counts["stores"]}
    result["notices"] = list(notices.values())
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    result["baked"] = state(bpy.data.objects["Terrain"])
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    terrain = add_terrain(33)
    result["unsaved"] = state(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "new.blend"))
    result["saved"] = state(terrain)
    terrain.adaptive_terrain.island_size = 17
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    result["beside"] = state(terrain)
print("RESULT", json.dumps(result))
