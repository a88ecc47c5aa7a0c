# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache of shaped land: its size, the removal of unused land, and its button."""

import os
import shutil
from pathlib import Path

import bpy
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.operators.land import cache as land_cache
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.session import session
from land_scenes import add


def other_stores(store: str, *names: str) -> list[str]:
    """Copy a shaped store, as for other settings; order the ages so that `store` is the oldest, then the first copy."""
    found = [shutil.copytree(store, Path(store).with_name(name)) for name in names]
    for age, folder in enumerate((*reversed(found), store), 1):
        os.utime(folder, (1e9 - age, 1e9 - age))
    return list(map(str, found))


def test_unused_shaped_land_is_removed_when_there_is_too_much(terrain, add_terrain, monkeypatch):
    """The one that was not used for longest first; never what another terrain of the scene shows."""

    def there() -> set[str]:
        return {str(folder) for folder, _ in land_folder.shaped_stores(terrain.adaptive_terrain.store)}

    other = add_terrain("Other")
    other.adaptive_terrain.store = terrain.adaptive_terrain.store
    bpy.context.view_layer.objects.active = other
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(other)
    first, second = other_stores(shown, "0" * 16, "1" * 16 + land_folder.OF_VIEWS)
    monkeypatch.setattr(derived_store, "MAX_BYTES", int(3.5 * land_folder.bytes_in(Path(first))))
    bpy.context.view_layer.objects.active = terrain
    add("scree", depth=10.0)
    bpy.ops.adaptive_terrain.shape()
    own = shaped_land.store_of(terrain)
    assert there() == {shown, second, own}
    terrain.adaptive_terrain.land.entries[0].scree.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == shown, "both terrains share it"
    monkeypatch.setattr(derived_store, "MAX_BYTES", 0)
    derived_store.remove_old(derived_store.Land(terrain.adaptive_terrain.store, second, False, None))
    assert there() == {shown, second}


def test_the_cache_says_what_it_holds_and_is_cleared(terrain):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(terrain)
    [other] = other_stores(shown, "0" * 16)
    beside = land_folder.folder_beside(terrain.adaptive_terrain.store)
    said = land_cache.describe_cache(terrain.adaptive_terrain.store)
    assert said[0] == str(beside) and said[1].endswith(" MB, stores: 1") and " 0 MB" not in "".join(said)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert Path(shown).exists() and not Path(other).exists() and not (beside / "tiles").exists()
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Shaped"


def test_the_cache_is_cleared_while_another_object_is_active(terrain):
    """Blender polls again when the dialog is confirmed, without the button's terrain."""
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    tiles = land_folder.folder_beside(terrain.adaptive_terrain.store) / "tiles"
    assert tiles.is_dir()
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    bpy.context.collection.objects.link(cube)
    bpy.context.view_layer.objects.active = cube
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"} and not tiles.exists()


def test_the_cache_keeps_what_a_terrain_shows_by_another_path(terrain, add_terrain, tmp_path):
    """A store behind a link, or by way of another folder, and one that was baked from it."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "link").symlink_to(tmp_path)
    add("scree")
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    for between in ("link", "scenes/.."):
        other = add_terrain()
        other.adaptive_terrain.store = f"{tmp_path}/{between}/hills"
        bpy.context.view_layer.objects.active = other
        add("scree")
        bpy.ops.adaptive_terrain.shape()
        derived_store._in_use.pop(terrain.session_uid, None)
        bpy.context.view_layer.objects.active = terrain
        assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
        assert Path(shaped_land.store_of(other)).is_dir() and shaped_land.state_of(other).shown == "Shaped"
        bpy.data.objects.remove(other)
        derived_store._in_use.clear()


def test_the_cache_drops_the_land_of_a_removed_terrain(terrain, add_terrain):
    add("scree")
    session.update_object(terrain, mode="RENDER")
    source, folder = terrain.adaptive_terrain.store, shaped_land.store_of(terrain)
    other = add_terrain()
    other.adaptive_terrain.store = source
    bpy.data.objects.remove(terrain)
    bpy.context.view_layer.objects.active = other
    assert land_cache.describe_cache(source)[1].endswith(" 0 MB, stores: 0")
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"} and not Path(folder).exists()
