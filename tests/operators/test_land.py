# SPDX-License-Identifier: GPL-3.0-or-later
"""The stack that shapes the land, in Blender: its settings, its list, its presets, and what a scene pays for it."""

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import lands
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.store import Draft, open_store
from adaptive_terrain.cbt_terrain.field.store_arrays import BLOCK_BYTES, PAGE_BYTES
from adaptive_terrain.cbt_terrain.land.catalogue import LAND_EFFECTS
from adaptive_terrain.cbt_terrain.land.mask import LIMITS
from adaptive_terrain.cbt_terrain.land.shape_store import run_shape
from adaptive_terrain.cbt_terrain.land.stack import stack_from
from adaptive_terrain.operators import handlers
from adaptive_terrain.operators.scene import (
    import_terrain,
    land_cache,
    land_jobs,
    land_masks,
    land_properties,
    land_request,
    land_stack,
    session,
    shape_land,
    shaped_land,
)
from adaptive_terrain.operators.scene.imported import imported_of
from adaptive_terrain.operators.scene.kernels_asked import kernels_for
from adaptive_terrain.operators.scene.land_entries import free_name
from adaptive_terrain.operators.scene.request import gather
from adaptive_terrain.operators.ui.land_panel import status_lines, time_text
from modal_runs import running, to_the_end
from rasters import write_raster


@pytest.fixture
def terrain(scene, add_terrain, store, tmp_path):
    """A terrain with a store of its own, of which nothing was shaped."""
    own = tmp_path / "hills"
    shutil.copytree(store, own)
    obj = add_terrain()
    obj.adaptive_terrain.store = str(own)
    land_request.forget()
    land_request.made.update(previews=0, stores=0)
    return obj


def add(effect: str, **numbers):
    assert bpy.ops.adaptive_terrain.land_add(effect=effect) == {"FINISHED"}
    land = bpy.context.object.adaptive_terrain.land
    entry = land.entries[land.active]
    for name, value in numbers.items():
        setattr(getattr(entry, effect), name, value)
    return entry


def names(terrain) -> list[str]:
    return [entry.name for entry in terrain.adaptive_terrain.land.entries]


def stack_now(terrain, tmp_path):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return land_stack.stack_of(terrain.evaluated_get(depsgraph), depsgraph, tmp_path / "masks")


@pytest.mark.parametrize("effect", LAND_EFFECTS)
def test_settings_are_those_of_the_declarations(terrain, tmp_path, effect):
    """Name by name; the default is the declaration's own to the last bit, the ends of the range are reached."""
    entry = add(effect)
    group = getattr(entry, effect)
    declared = LAND_EFFECTS[effect].parameters
    assert set(group.bl_rna.properties.keys()) - {"rna_type", "name"} == {parameter.name for parameter in declared}
    assert stack_now(terrain, tmp_path).entries[0].parameters == {}
    for parameter in declared:
        assert land_properties.number_of(parameter, group) == parameter.default
        for value in (parameter.least, parameter.most):
            land_properties.set_number(parameter, group, value)
            assert land_properties.number_of(parameter, group) == pytest.approx(value, rel=1e-6, abs=1e-12)
    stack_now(terrain, tmp_path).check()


def test_lengths_and_angles_have_their_units():
    declared = [(name, parameter) for name, effect in LAND_EFFECTS.items() for parameter in effect.parameters]
    for name, parameter in declared:
        item = land_properties.GROUPS[name].__annotations__[parameter.name].keywords
        if parameter.unit == "m":
            assert item["unit"] == "LENGTH", (name, parameter.name)
        elif parameter.unit == land_properties.DEGREES:
            assert item["subtype"] == "ANGLE" and item["max"] <= 2 * np.pi + 1e-6, (name, parameter.name)
        elif parameter.unit:
            unit = parameter.unit.replace("m2", "m²")
            said = "unit" in item or parameter.unit == parameter.name or f"({unit})" in item["name"]
            assert said or item["description"].endswith(unit), (name, parameter.name)
            assert len(item["name"]) <= 15, "what is longer is cut off on a panel of the usual width"
        assert item["options"] == set(), "another number is another land: nothing is animated"


def test_the_list_is_worked_as_a_list_of_modifiers(terrain):
    add("relief", wave=80.0)
    add("thermal")
    add("relief")
    assert names(terrain) == ["Fine Relief", LAND_EFFECTS["thermal"].label, "Fine Relief.001"]
    land = terrain.adaptive_terrain.land
    assert [entry.seed for entry in land.entries] == [0, 1, 2]
    land.active = 0
    assert bpy.ops.adaptive_terrain.land_duplicate() == {"FINISHED"}
    assert names(terrain)[:2] == ["Fine Relief", "Fine Relief.002"] and land.active == 1
    assert land.entries[1].relief.wave == 80.0 and land.entries[1].seed == land.entries[0].seed
    assert bpy.ops.adaptive_terrain.land_move(by=1) == {"FINISHED"}
    assert names(terrain)[2] == "Fine Relief.002" and land.active == 2
    assert bpy.ops.adaptive_terrain.land_move(by=5) == {"CANCELLED"}
    assert bpy.ops.adaptive_terrain.land_remove() == {"FINISHED"}
    assert names(terrain)[2:] == ["Fine Relief.001"] and land.active == 2
    while land.entries:
        bpy.ops.adaptive_terrain.land_remove()
    assert not bpy.ops.adaptive_terrain.land_remove.poll()


def test_names_are_numbered_as_blender_does():
    assert free_name("Snow", set()) == "Snow"
    assert free_name("Snow", {"Snow", "Snow.001"}) == "Snow.002"
    assert free_name("Snow.001", {"Snow.001"}) == "Snow.002" or free_name("Snow.001", {"Snow.001"}) == "Snow.003"


def test_a_copied_object_has_a_stack_of_its_own(terrain):
    add("relief", wave=80.0)
    copy = terrain.copy()
    copy.adaptive_terrain.land.entries[0].relief.wave = 40.0
    assert terrain.adaptive_terrain.land.entries[0].relief.wave == 80.0
    assert copy.adaptive_terrain.land.entries[0].effect == "relief"


def test_a_stack_is_saved_and_opened(terrain, tmp_path):
    entry = add("thermal", depth=12.5)
    entry.on, entry.mask.kind, entry.mask.height.use = False, "RULE", True
    path = str(tmp_path / "land.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    entry = bpy.data.objects["Terrain"].adaptive_terrain.land.entries[0]
    assert (entry.effect, entry.on, entry.thermal.depth, entry.mask.kind) == ("thermal", False, 12.5, "RULE")


def test_an_effect_of_another_version_is_told_of(terrain):
    entry = add("relief")
    entry.effect = "glacier"
    with pytest.raises(session.TerrainError, match="'glacier' is not one of this version's: rivers"):
        session.update_object(terrain)
    entry.on = False
    session.update_object(terrain)


def test_a_preset_file_is_the_commands_file(terrain, tmp_path):
    given = {
        "version": 1,
        "entries": [
            {"effect": "rivers", "parameters": {"years": 20000}, "seed": 4, "name": "Old rivers"},
            {"effect": "snow", "on": False, "parameters": {"wind": 90, "line": 1200},
             "mask": {"factor": 0.5, "rules": [{"of": "height", "low": 600, "edge": 50},
                                               {"of": "slope", "high": 45, "edge": 10},
                                               {"of": "aspect", "low": 0, "edge": 0.5, "direction": 270}]}},
        ],
    }  # fmt: skip
    file = tmp_path / "stack.json"
    file.write_text(json.dumps(given))
    add("relief")
    assert bpy.ops.adaptive_terrain.land_preset(filepath=str(file)) == {"FINISHED"}
    land = terrain.adaptive_terrain.land
    assert names(terrain) == ["Old rivers", LAND_EFFECTS["snow"].label]
    assert land.entries[1].snow.wind == pytest.approx(np.pi / 2) and land.entries[1].mask.slope.high == pytest.approx(
        np.pi / 4
    )
    rivers, snow = land_stack.preset_of(land).entries
    assert rivers.parameters == {"years": 20000.0} and (rivers.seed, rivers.mask) == (4, None)
    assert snow.parameters == pytest.approx({"wind": 90.0, "line": 1200.0}) and not snow.on
    found = [(rule.of, rule.low, rule.high, rule.edge, rule.direction) for rule in snow.mask.rules]
    for rule, expected in zip(
        found,
        [("height", 600, np.inf, 50, 0), ("slope", -np.inf, 45, 10, 0), ("aspect", 0, np.inf, 0.5, 270)],
        strict=True,
    ):
        assert rule[0] == expected[0] and rule[1:] == pytest.approx(expected[1:], abs=1e-4)
    file.write_text('{"version": 1, "entries": [{"effect": "rivers", "parameters": {"age": 3}}]}')
    with pytest.raises(RuntimeError, match="has a parameter 'age'; expected some of: years"):
        bpy.ops.adaptive_terrain.land_preset(filepath=str(file))
    assert names(terrain)[0] == "Old rivers"


def test_bundled_presets_can_be_applied(terrain):
    files = [path for folder in bpy.utils.preset_paths("adaptive_terrain/land") for path in sorted_files(folder)]
    assert len(files) >= 4
    for file in files:
        assert bpy.ops.adaptive_terrain.land_preset(filepath=file) == {"FINISHED"}
        assert len(terrain.adaptive_terrain.land.entries) >= 2


def test_a_preset_is_fitted_to_the_lands_heights(terrain, tmp_path):
    low, high = imported_of(terrain.adaptive_terrain).heights_m
    file, foot = tmp_path / "high.json", max(low, 0.0)
    given = {"version": 1, "heights": [1000, 3000], "entries": [{"effect": "snow", "parameters": {"line": 2500}}]}
    file.write_text(json.dumps(given))
    assert bpy.ops.adaptive_terrain.land_preset(filepath=str(file)) == {"FINISHED"}
    line = terrain.adaptive_terrain.land.entries[0].snow.line
    assert line == pytest.approx(foot + 0.75 * (high - foot)) and abs(line - 2500) > 100
    assert land_stack.preset_of(terrain.adaptive_terrain.land).heights is None


def sorted_files(folder: str) -> list[str]:
    import os

    return [os.path.join(folder, name) for name in sorted(os.listdir(folder)) if name.endswith(".json")]


def test_a_preset_is_saved_and_removed(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda _kind, path="", create=False: str(tmp_path))
    monkeypatch.setattr(
        bpy.utils, "preset_find", lambda name, _folder, ext: str(f) if (f := tmp_path / (name + ext)).exists() else None
    )
    add("thermal", depth=44.0)
    assert bpy.ops.adaptive_terrain.land_preset_add(name="My land") == {"FINISHED"}
    [file] = tmp_path.glob("My*.json")
    assert json.loads(file.read_text())["entries"][0]["parameters"] == {"depth": 44.0}
    with pytest.raises(RuntimeError, match="There is a preset 'My land' already"):
        bpy.ops.adaptive_terrain.land_preset_add(name="My land")
    assert bpy.ops.adaptive_terrain.land_preset_add(name="My land", remove_name=True) == {"FINISHED"}
    assert not file.exists()


def test_a_preset_says_which_masks_it_cannot_hold(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda _kind, path="", create=False: str(tmp_path))
    entry = add("relief")
    entry.mask.kind, entry.mask.image = "IMAGE", bpy.data.images.new("Paint", 4, 4)
    with pytest.raises(RuntimeError, match="'Paint', which masks 'Fine Relief', is in no file of its own"):
        bpy.ops.adaptive_terrain.land_preset_add(name="Painted")
    assert not list(tmp_path.glob("Painted*.json"))
    rules = [{"of": "aspect", "low": -0.5, "high": 0.5}]
    stack = stack_from({"version": 1, "entries": [{"effect": "relief", "mask": {"rules": rules}}]})
    [said] = land_stack.fill(terrain.adaptive_terrain.land, stack)
    assert said == "Entry 1, Fine Relief: its mask has a high limit of aspect, which is left out"


def test_a_mask_without_pixels_is_told_of_as_a_mask(terrain):
    entry = add("relief")
    entry.mask.kind, entry.mask.image = "IMAGE", bpy.data.images.new("Lost", 4, 4)
    entry.mask.image.source = "FILE"
    with pytest.raises(session.TerrainError, match="The image 'Lost' of a mask has no pixels"):
        session.update_object(terrain)


def test_a_file_that_cannot_be_exported_is_told_of_before_the_land_is_shaped(terrain, tmp_path):
    add("thermal")
    with pytest.raises(RuntimeError, match="there is no folder"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "none" / "land.tif"))
    assert land_request.made["stores"] == 0


def test_a_hidden_terrain_costs_nothing(terrain):
    """Counted: neither previews nor stores are made of it, whatever asks; once it is shown they are."""
    add("relief")
    for hide in ("hide_viewport", "eye"):
        if hide == "eye":
            terrain.hide_viewport = False
            terrain.hide_set(True)
        else:
            terrain.hide_viewport = True
        terrain.hide_render = True
        bpy.context.view_layer.update()
        session.update_object(terrain)
        handlers.update_all(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), "VIEWPORT")
        assert session.record_of(terrain).status.request.land is None
        with pytest.raises(RuntimeError, match="is hidden in viewports and in renders"):
            bpy.ops.adaptive_terrain.shape()
    assert land_request.made == {"previews": 0, "stores": 0}
    terrain.hide_set(False)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert land_request.made == {"previews": 1, "stores": 0}


def test_a_preview_first_and_the_land_when_it_is_shaped(terrain):
    add("thermal", scree_angle=0.4)
    state = shaped_land.state_of(terrain)
    assert (state.active, state.wanted) == (True, True)
    session.update_object(terrain)
    state = shaped_land.state_of(terrain)
    assert state.shown == "Preview" and state.step_m == 10.0 and list(state.ms) == [0]
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    state = shaped_land.state_of(terrain)
    assert (state.shown, state.wanted) == ("Shaped", False) and state.tiles == (1, 1)
    assert [name for name, _ in status_lines(state)] == ["Shown", "Tiles", "Time"]
    folder = shaped_land.store_of(terrain)
    request = session.record_of(terrain).status.request
    assert request.store == folder and request.land is None
    assert land_request.made == {"previews": 1, "stores": 1}
    bpy.ops.adaptive_terrain.shape()
    assert land_request.made == {"previews": 1, "stores": 1}, "what is there is not made again"


def test_the_land_is_what_the_command_makes(terrain, tmp_path):
    add("thermal", depth=60.0)
    bpy.ops.adaptive_terrain.shape()
    stack = land_stack.preset_of(terrain.adaptive_terrain.land)
    run_shape(terrain.adaptive_terrain.store, stack, tmp_path / "other")
    mine, other = open_store(shaped_land.store_of(terrain)), open_store(tmp_path / "other")
    assert mine.key == other.key and np.array_equal(mine.heights(), other.heights())


def test_undo_brings_the_land_before_back_at_once(terrain):
    """The settings alone decide which store is shown."""
    entry = add("thermal")
    bpy.ops.adaptive_terrain.shape()
    first = shaped_land.store_of(terrain)
    entry.thermal.depth = 3.0
    bpy.ops.adaptive_terrain.shape()
    assert shaped_land.store_of(terrain) != first
    entry.thermal.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == first and land_request.made["stores"] == 2
    entry.on = False
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == terrain.adaptive_terrain.store
    assert shaped_land.state_of(terrain) == shaped_land.State()


def test_a_render_has_all_of_the_land_and_waits_for_it(terrain):
    add("thermal", depth=80.0)
    session.update_object(terrain)
    session.update_object(terrain, mode="RENDER")
    assert land_request.made == {"previews": 1, "stores": 1}
    assert shaped_land.state_of(terrain).shown == "Shaped"
    assert session.record_of(terrain).field.raster_key == open_store(shaped_land.store_of(terrain)).raster_key


def other_stores(store: str, *names: str) -> list[str]:
    """Copies of a shaped store, as of other settings; the first was not used for longest, `store` for longer."""
    found = [shutil.copytree(store, Path(store).with_name(name)) for name in names]
    for age, folder in enumerate((*reversed(found), store), 1):
        os.utime(folder, (1e9 - age, 1e9 - age))
    return list(map(str, found))


def test_shaped_land_that_nobody_shows_goes_when_there_is_too_much(terrain, add_terrain, monkeypatch):
    """The one that was not used for longest first; never what another terrain of the scene shows."""

    def there() -> set[str]:
        return {str(folder) for folder, _ in land_request.shaped_stores(terrain.adaptive_terrain.store)}

    other = add_terrain("Other")
    other.adaptive_terrain.store = terrain.adaptive_terrain.store
    bpy.context.view_layer.objects.active = other
    add("thermal")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(other)
    first, second = other_stores(shown, "0" * 16, "1" * 16 + land_request.OF_VIEWS)
    monkeypatch.setattr(land_request, "MOST_BYTES", int(3.5 * land_request.bytes_in(Path(first))))
    bpy.context.view_layer.objects.active = terrain
    add("thermal", depth=10.0)
    bpy.ops.adaptive_terrain.shape()
    own = shaped_land.store_of(terrain)
    assert there() == {shown, second, own}
    terrain.adaptive_terrain.land.entries[0].thermal.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == shown, "both terrains share it"
    monkeypatch.setattr(land_request, "MOST_BYTES", 0)
    land_request.remove_old(land_request.Land(terrain.adaptive_terrain.store, second, False, None))
    assert there() == {shown, second}


def test_shaped_land_that_was_damaged_is_made_again(terrain):
    """Half a file is left of it: what waits for land makes it again, where Clear Land Cache keeps what is shown."""
    add("thermal")
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    folder = land_request.shaped_stores(terrain.adaptive_terrain.store)[0][0]
    samples = next(folder.glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    session.clear()
    samples.unlink()
    samples.write_bytes(whole[: len(whole) // 2])
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert next(folder.glob("data-*/samples.npy")).read_bytes() == whole


def cut_off(store) -> bytes:
    """Half a file of samples is left, as where a copy was cut off; what the whole one held."""
    session.clear()
    samples = next(Path(store).glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    samples.unlink()  # the old one may still be mapped
    samples.write_bytes(whole[: len(whole) // 2])
    return whole


@pytest.mark.parametrize("mode", ["RENDER", "VIEWPORT"])
def test_what_needs_damaged_land_makes_it_again_and_says_so(terrain, capsys, mode):
    """A render waits for it; a viewport shows its preview meanwhile."""
    add("thermal")
    bpy.ops.adaptive_terrain.shape()
    folder = shaped_land.store_of(terrain)
    whole = cut_off(folder)
    session.update_object(terrain, mode=mode)
    [line] = capsys.readouterr().out.splitlines()
    assert line.startswith(f"Adaptive Terrain: The shaped land in {folder!r} is damaged, and is made again from its")
    assert "samples.npy is damaged (it has" in line and line.endswith(").")
    state = shaped_land.state_of(terrain)
    assert (state.shown, session.record_of(terrain).status.error) == ("Shaped" if mode == "RENDER" else "Preview", "")
    session.update_object(terrain, mode="RENDER")
    assert next(Path(folder).glob("data-*/samples.npy")).read_bytes() == whole
    assert land_request.made["stores"] == 2 and not capsys.readouterr().out


def test_damage_that_only_an_update_finds_is_mended_too(terrain, wide_store, tmp_path):
    """When a store is opened a few blocks of each array are looked at, and this is none of them."""
    shutil.copytree(wide_store, tmp_path / "wide")
    terrain.adaptive_terrain.store = str(tmp_path / "wide")
    terrain.adaptive_terrain.render.error_px, terrain.adaptive_terrain.render.error_m = 0.0, 3.0
    add("relief")
    bpy.ops.adaptive_terrain.shape()
    folder = shaped_land.store_of(terrain)
    session.clear()
    samples = next(Path(folder).glob("data-*/samples.npy"))
    whole = samples.read_bytes()
    first = PAGE_BYTES + BLOCK_BYTES
    samples.unlink()
    samples.write_bytes(whole[:first] + b"\xff" * BLOCK_BYTES + whole[first + BLOCK_BYTES :])  # no numbers
    open_store(folder)
    session.update_object(terrain, mode="RENDER")
    assert land_request.made["stores"] == 2
    assert next(Path(folder).glob("data-*/samples.npy")).read_bytes() == whole


def test_what_is_the_users_own_is_left_as_it_is_when_it_is_damaged(terrain):
    """A source, and what was baked: an error that names the file."""
    source = terrain.adaptive_terrain.store
    add("thermal")
    cut_off(source)
    for mode in ("RENDER", "VIEWPORT"):
        with pytest.raises(session.TerrainError, match=r"hills/data-\w+/samples.npy is damaged .*import the terrain"):
            session.update_object(terrain, mode=mode)
    assert (Path(source) / "store.json").is_file() and land_request.made["stores"] == 0


def test_a_damaged_baked_store_is_an_error(terrain):
    add("thermal")
    bpy.ops.adaptive_terrain.bake_land()
    baked = terrain.adaptive_terrain.store
    cut_off(baked)
    with pytest.raises(session.TerrainError, match=r"hills_baked/data-\w+/samples.npy is damaged"):
        session.update_object(terrain, mode="RENDER")
    assert (Path(baked) / "store.json").is_file()


def test_land_with_a_folder_in_place_of_its_file_is_made_again(terrain):
    add("thermal")
    bpy.ops.adaptive_terrain.shape()
    file = Path(shaped_land.store_of(terrain)) / "store.json"
    file.unlink()
    (file / "more").mkdir(parents=True)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    session.update_object(terrain, mode="RENDER")
    assert shaped_land.state_of(terrain).shown == "Shaped" and file.is_file()


def test_the_cache_says_what_it_holds_and_is_cleared(terrain):
    add("thermal")
    bpy.ops.adaptive_terrain.shape()
    shown = shaped_land.store_of(terrain)
    [other] = other_stores(shown, "0" * 16)
    beside = land_request.folder_beside(terrain.adaptive_terrain.store)
    said = land_cache.lines(terrain.adaptive_terrain.store)
    assert said[0] == str(beside) and said[1].endswith(" MB, stores: 1") and " 0 MB" not in "".join(said)
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert Path(shown).exists() and not Path(other).exists() and not (beside / "tiles").exists()
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Shaped"


def test_the_cache_keeps_what_a_terrain_shows_by_another_path(terrain, add_terrain, tmp_path):
    """A store behind a link, or by way of another folder, and one that was baked from it."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "link").symlink_to(tmp_path)
    add("thermal")
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    for between in ("link", "scenes/.."):
        other = add_terrain()
        other.adaptive_terrain.store = f"{tmp_path}/{between}/hills"
        bpy.context.view_layer.objects.active = other
        add("thermal")
        bpy.ops.adaptive_terrain.shape()
        land_request._in_use.pop(terrain.session_uid, None)
        bpy.context.view_layer.objects.active = terrain
        assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
        assert Path(shaped_land.store_of(other)).is_dir() and shaped_land.state_of(other).shown == "Shaped"
        bpy.data.objects.remove(other)
        land_request._in_use.clear()


def test_baked_land_needs_no_stack(terrain):
    add("thermal", depth=80.0)
    before = open_store(terrain.adaptive_terrain.store).key
    source = terrain.adaptive_terrain.store
    assert bpy.ops.adaptive_terrain.bake_land() == {"FINISHED"}
    baked = terrain.adaptive_terrain.store
    assert baked == source + "_baked" and not terrain.adaptive_terrain.land.entries
    assert open_store(source).key == before != open_store(baked).key
    beside = land_request.folder_beside(source)
    assert (beside / "tiles").is_dir() and str(beside) in land_cache.lines(baked), "for Undo"
    assert bpy.ops.adaptive_terrain.land_clear() == {"FINISHED"}
    assert not land_request.shaped_stores(source) and not (beside / "tiles").exists() and Path(source).is_dir()
    session.update_object(terrain)
    assert session.record_of(terrain).field.raster_key == open_store(baked).raster_key
    with pytest.raises(RuntimeError, match="nothing to bake: the stack is empty"):
        bpy.ops.adaptive_terrain.bake_land()


def test_heights_are_exported_with_what_the_stack_leaves(terrain, tmp_path):
    import rasterio

    add("thermal", depth=80.0)
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.tif")) == {"FINISHED"}
    shaped = open_store(shaped_land.land_request.folder_beside(terrain.adaptive_terrain.store) / only_shaped(terrain))
    with rasterio.open(tmp_path / "land.tif") as file:
        assert np.array_equal(file.read(1)[::-1], shaped.heights())
    assert sorted(path.name for path in tmp_path.glob("land_*.tif")) == [f"land_{n}.tif" for n in sorted(shaped.layers)]
    with pytest.raises(RuntimeError, match="is of no format"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "land.png"))


def only_shaped(terrain) -> str:
    [folder] = {path.parent for path in land_request.folder_beside(terrain.adaptive_terrain.store).glob("*/store.json")}
    return folder.name


def test_masks_by_rule_image_and_object(terrain, tmp_path):
    entry = add("thermal")
    entry.mask.kind = "IMAGE"
    with pytest.raises(session.TerrainError, match="masked by an image, and none is chosen"):
        session.update_object(terrain)
    image = bpy.data.images.new("Paint", 6, 3, float_buffer=True)
    pixels = np.zeros((3, 6, 4), np.float32)
    pixels[0, :2, 0], pixels[2, 5, 0] = 1.0, 0.25  # the lower rows of an image are south
    image.pixels.foreach_set(pixels.ravel())
    entry.mask.image, entry.mask.factor = image, 0.5
    [found] = stack_now(terrain, tmp_path).entries
    kept = np.load(found.mask.image)
    assert found.mask.factor == 0.5 and kept.shape == (3, 6)
    assert (kept[2, :2] == 1.0).all() and kept[0, 5] == 0.25 and kept.sum() == 2.25, "the first row is north"
    entry.mask.kind = "OBJECT"
    with pytest.raises(session.TerrainError, match="masked by an object, and none is chosen"):
        session.update_object(terrain)
    entry.mask.object = terrain
    with pytest.raises(session.TerrainError, match="is masked by the terrain itself"):
        session.update_object(terrain)
    mesh = bpy.data.meshes.new("Patch")
    mesh.from_pydata([(0, 0, 5), (640, 0, 9), (640, 320, 0), (0, 320, 0)], [], [(0, 1, 2, 3)])
    patch = bpy.data.objects.new("Patch", mesh)
    bpy.context.scene.collection.objects.link(patch)
    entry.mask.object = patch
    kept = np.load(stack_now(terrain, tmp_path).entries[0].mask.image)
    assert kept.shape == (512, 512) and kept[:256, 256:].mean() == pytest.approx(0.5, abs=0.01)
    assert kept[256:].max() == 0.0 and kept[:, :255].max() == 0.0, "only the north-eastern quarter, its southern half"
    assert kept[:127].max() == 0.0 and kept[130:255, 258:].min() == 1.0
    session.update_object(terrain)


def test_a_shadow_is_the_part_that_is_covered():
    """Of a triangle: its area, from points that no triangle rule was written for."""
    triangle = np.array([[[-30.0, -20.0], [45.0, -10.0], [5.0, 28.0]]])
    (ax, ay), (bx, by), (cx, cy) = triangle[0]
    area = abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2
    found = land_masks.shadow(triangle, (100.0, 60.0))
    assert found.shape == (308, 512) and found.sum() * (100.0 / 512) * (60.0 / 308) == pytest.approx(area, rel=2e-3)
    assert land_masks.shadow(triangle[:, ::-1], (100.0, 60.0)).tobytes() == found.tobytes()
    assert land_masks.shadow(triangle + 500.0, (100.0, 60.0)).max() == 0.0


def test_times_are_short():
    assert [time_text(ms) for ms in (None, 0.4, 35.2, 4200.0)] == ["-", "0.4 ms", "35.2 ms", "4.2 s"]


def test_water_lies_on_the_land_that_the_stack_makes(terrain):
    """Which is shaped first: a preview is not what it is cut against."""
    add("water", sea=-10.0)
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    assert land_request.made["stores"] == 1
    [water] = terrain.children
    heights = np.empty(3 * len(water.data.vertices), np.float32)
    water.data.vertices.foreach_get("co", heights)
    assert (np.abs(heights[2::3] + 10.0) < 1e-3).mean() > 0.5, "the sea of the stack"


@pytest.fixture(scope="module")
def wide_store(tmp_path_factory):
    """1,100 x 1,500 samples, 10 and 8 m apart: three levels, of which the finest goes by tiles."""
    path = tmp_path_factory.mktemp("wide") / "hills"
    draft = Draft(path)
    samples = draft.allocate("samples", (1100, 1500), np.float32)
    y, x = np.mgrid[0:1100, 0:1500]
    samples[:] = 60 * np.sin(x / 31) * np.cos(y / 27)
    draft.publish(build(samples, 8.0, 10.0, missing=0, allocate=draft.allocate), "wide", {})
    return path


def look_at(scene, east: float, north: float) -> None:
    """Straight down from 400 m on a square of some 300 m."""
    camera = scene.camera
    camera.location, camera.rotation_euler = (east, north, 460.0), (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()


def test_only_what_the_shot_sees_is_fine(scene, terrain, wide_store, tmp_path):
    """Tiles are counted; another frame adds its own, and what was there before stays."""
    shutil.copytree(wide_store, tmp_path / "wide")
    terrain.adaptive_terrain.store = str(tmp_path / "wide")
    terrain.adaptive_terrain.land.where = "SEEN"
    add("relief", wave=64.0, plains=0.2)
    scene.frame_start = scene.frame_end = scene.frame_current
    look_at(scene, -4000.0, -3000.0)
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    built, there_are = shaped_land.state_of(terrain).tiles
    assert 0 < built < there_are and shaped_land.state_of(terrain).wanted, "another shot may look elsewhere"
    folder = shaped_land.store_of(terrain)
    change = open_store(folder).heights() - open_store(wide_store).heights()
    fine = [np.abs(np.diff(part, 2)).mean() for part in (change[100:200, 150:250], change[800:900, 1200:1300])]
    assert fine[0] > 3.0 * fine[1], "fine waves where the camera looks only"
    session.update_object(terrain, mode="RENDER")
    assert land_request.made["stores"] == 1, "the render finds its tiles"
    look_at(scene, 4000.0, 3000.0)
    session.update_object(terrain, mode="RENDER")
    assert land_request.made["stores"] == 2 and shaped_land.state_of(terrain).tiles[0] > built
    look_at(scene, -4000.0, -3000.0)
    session.update_object(terrain, mode="RENDER")
    assert land_request.made["stores"] == 2
    again = open_store(folder).heights() - open_store(wide_store).heights()
    assert np.array_equal(again[50:250, 60:300], change[50:250, 60:300])


def test_a_frozen_terrain_keeps_its_triangles_and_takes_the_shaped_heights(terrain, wide_store):
    """Also one whose raster is larger than a preview: that one is not shown on it."""
    terrain.adaptive_terrain.store = str(wide_store)
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.freeze() == {"FINISHED"}
    before = len(terrain.data.polygons)
    add("relief", wave=64.0)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Source" and len(terrain.data.polygons) == before
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert shaped_land.state_of(terrain).shown == "Shaped" and len(terrain.data.polygons) == before
    shutil.rmtree(land_request.folder_beside(str(wide_store)))


def test_a_damaged_shaped_store_is_made_again(terrain):
    add("thermal")
    bpy.ops.adaptive_terrain.shape()
    file = Path(shaped_land.store_of(terrain)) / "store.json"
    file.write_text("{}")
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Preview"
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert shaped_land.state_of(terrain).shown == "Shaped"


def test_a_mask_by_rules_about_anything_that_the_ground_has(terrain, tmp_path):
    """Each rule of the menu is one of the stack, with its limits in the stack's units, and comes back from a file."""
    entry = add("thermal")
    entry.mask.kind = "RULE"
    for of in land_properties.RULES:
        assert bpy.ops.adaptive_terrain.land_rule_add(of=of) == {"FINISHED"}
        getattr(entry.mask, of).low = 0.25
    rules = stack_now(terrain, tmp_path).entries[0].mask.rules
    assert {rule.of for rule in rules} == set(LIMITS) - {"aspect"}
    for rule in rules:
        assert rule.low == pytest.approx(np.degrees(0.25) if rule.of == "slope" else 0.25)
    kept = land_stack.preset_of(terrain.adaptive_terrain.land)
    entry.mask.kind = "NONE"
    assert land_stack.fill(terrain.adaptive_terrain.land, kept) == []
    assert stack_now(terrain, tmp_path).entries[0].mask.rules == rules
    only = terrain.adaptive_terrain.land.entries[0].mask
    for of in land_properties.RULES:
        getattr(only, of).use = of == "sediment"
    with pytest.raises(session.TerrainError, match="about sediment, which is not there"):
        session.update_object(terrain)
    assert shaped_land.state_of(terrain).note == "Not shown: read why, above"
    add("rivers")
    assert bpy.ops.adaptive_terrain.land_move(by=-1) == {"FINISHED"}
    session.update_object(terrain)


def test_a_linked_terrain_says_why_its_land_cannot_be_changed(terrain, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {terrain})
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.objects = [name for name in there.objects if name == terrain.name]
    [linked] = here.objects
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.view_layer.objects.active = linked
    for name in ("land_add", "shape", "land_preset", "bake_land", "export_heights", "water_surface"):
        with pytest.raises(RuntimeError, match="is linked from a library, or overrides one, and is left alone: make"):
            getattr(bpy.ops.adaptive_terrain, name)()


@pytest.mark.parametrize("packed", [False, True])
def test_a_mask_that_was_cut_off_is_told_of(terrain, tmp_path, packed):
    """Blender itself reads such a file, partly black."""
    file = tmp_path / "mask.png"
    write_raster(file, np.random.default_rng(0).integers(1, 255, (90, 70)).astype(np.uint8))
    whole = file.read_bytes()
    entry = add("relief")
    for content, said in (
        (whole[: len(whole) // 2], r"is damaged \(it ends inside a chunk\): expected a whole PNG; get the file"),
        (whole[:-12], r"is damaged \(it ends before its last chunk\)"),
        (whole[:200] + b"?" + whole[201:], r"is damaged \(its chunk IDAT differs from its checksum\)"),
    ):
        file.write_bytes(content)
        image = bpy.data.images.load(str(file))
        if packed:
            image.pack()
            file.unlink()
        entry.mask.kind, entry.mask.image = "IMAGE", image
        with pytest.raises(session.TerrainError, match=said):
            session.update_object(terrain)
    file.write_bytes(whole)
    entry.mask.image = bpy.data.images.load(str(file))
    session.update_object(terrain)


@pytest.mark.parametrize("land", ["CANYON", "DUNES"])
def test_a_built_in_land_is_added_as_it_is_with_the_stack_that_suits_it(scene, monkeypatch, tmp_path, land):
    """Of dunes there is none, and they get the size that was asked for."""
    given = lands.LANDS[land.lower()]
    monkeypatch.setattr(import_terrain, "user_folder", lambda: str(tmp_path))
    assert bpy.ops.mesh.adaptive_terrain_add(land=land, shape=True, size=40.0) == {"FINISHED"}
    settings = bpy.context.object.adaptive_terrain
    if not given.preset:
        assert tuple(settings.extent) == (40.0, 40.0) and not settings.land.entries
        return
    assert settings.extent[0] == given.side and settings.height_scale == 1.0
    [file] = (f for folder in bpy.utils.preset_paths("adaptive_terrain/land") for f in Path(folder).glob("desert.json"))
    expected = [entry["effect"] for entry in json.loads(file.read_text())["entries"]]
    assert [entry.effect for entry in settings.land.entries] == expected
    assert shaped_land.state_of(bpy.context.object).shown == "Preview", "the rest when it is asked for"


@pytest.mark.parametrize("by", ["ESC", "cross"])
def test_looking_at_frames_can_be_cancelled(terrain, monkeypatch, by):
    """The scene is at its frame again, and nothing was shaped."""
    add("thermal")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    scene.frame_set(450)  # further than a turn gets
    monkeypatch.setattr(shape_land, "TURN_S", 0.02)
    names = ("invoke", "modal", "cancel", "_look", "_start", "_end", "_failed", "_take")
    operator = running(shape_land.ShapeLand, terrain, names)
    assert operator.began == {"RUNNING_MODAL"}
    assert operator.modal(operator.context, SimpleNamespace(type="TIMER")) == {"PASS_THROUGH"}
    assert scene.frame_current != 450 and land_jobs.progress_of(terrain)[1] == "Looking at frames"
    if by == "ESC":
        assert operator.modal(operator.context, SimpleNamespace(type="ESC")) == {"PASS_THROUGH"}
    else:
        assert bpy.ops.adaptive_terrain.shape_cancel() == {"FINISHED"}
    assert to_the_end(operator) == {"CANCELLED"}
    assert scene.frame_current == 450 and not land_jobs.running and land_request.made["stores"] == 0


@pytest.mark.parametrize("by", ["file", "undo"])
def test_looking_at_frames_ends_where_the_scene_goes(terrain, tmp_path, monkeypatch, by):
    """Another file is opened, which ends what runs; or Undo puts another scene in its place."""
    add("thermal")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "land.blend"))
    monkeypatch.setattr(shape_land, "TURN_S", 0.02)
    names = ("invoke", "modal", "cancel", "_look", "_start", "_end", "_failed", "_take")
    operator = running(shape_land.ShapeLand, terrain, names)
    assert operator.modal(operator.context, SimpleNamespace(type="TIMER")) == {"PASS_THROUGH"}
    assert bpy.context.scene.frame_current != 1 and land_jobs.running
    if by == "file":
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "land.blend"))
        operator.cancel(operator.context)
        operator.context.window_manager.event_timer_remove.assert_called_once()
    else:
        bpy.ops.ed.undo_push(message="before")
        bpy.ops.ed.undo_push(message="after")
        assert bpy.ops.ed.undo() == {"FINISHED"}
        assert to_the_end(operator) == {"CANCELLED"}
    assert not land_jobs.running and land_request.made["stores"] == 0


def test_a_preview_waits_for_the_kernels_of_its_effects(terrain):
    add("thermal")
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(module.__name__.endswith("land.thermal") for module in kernels_for(request))
    bpy.ops.adaptive_terrain.shape()
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert not any(".land." in module.__name__ for module in kernels_for(request)), "what is shaped needs none"
    terrain.adaptive_terrain.interpolation = "bicubic"
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(".bicubic." in module.__name__ for module in kernels_for(request))
