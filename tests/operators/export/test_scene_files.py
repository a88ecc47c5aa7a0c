# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a scene: with the numbers that Blender itself shows, and the folders that it does not list."""

from pathlib import Path

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.export import scene_files


@pytest.fixture
def home(scene, tmp_path):
    """Return the folder of a saved, empty scene."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return tmp_path


def names(*frames) -> list[str]:
    return [path.name for path in scene_files.scene_files(frames or [1])]


def add_object(data=None):
    obj = bpy.data.objects.new("Object", data or bpy.data.meshes.new("Mesh"))
    bpy.context.scene.collection.objects.link(obj)
    return obj


@pytest.mark.parametrize("mode", ["CLIP", "EXTEND", "REPEAT", "PING_PONG"])
@pytest.mark.parametrize("length", [2, 4])  # of one file, PING_PONG crashes Blender
def test_a_volume_counts_with_the_file_that_blender_loads(home, mode, length):
    volume = bpy.data.volumes.new("Smoke")
    volume.filepath, volume.is_sequence, volume.sequence_mode = "//smoke_001.vdb", True, mode
    volume.frame_start, volume.frame_duration, volume.frame_offset = 2, length, 3
    obj = add_object(volume)
    for frame in range(-5, 12):
        bpy.context.scene.frame_set(frame)
        grids = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        grids.load()
        shown = [] if grids.frame == 2**31 - 1 else [f"smoke_{grids.frame:03d}.vdb"]
        assert names(frame) == (shown or ["smoke_001.vdb"]), frame


def test_tiles_of_an_image_count_and_packed_images_do_not(home):
    for name in ("rock[1].1001.png", "rock[1].1012.png", "rock1.1001.png", "packed.png"):
        (home / name).write_bytes(b"x")
    image = bpy.data.images.new("Tiles", 1, 1)
    image.source, image.filepath, image.use_fake_user = "TILED", "//rock[1].<UDIM>.png", True
    packed = bpy.data.images.load("//packed.png")
    packed.pack()
    assert names() == ["rock[1].1001.png", "rock[1].1012.png"]


def test_sounds_do_not_count_and_missing_files_do(home):
    image = bpy.data.images.new("Missing", 1, 1)
    image.source, image.filepath, image.use_fake_user = "FILE", "//gone.png", True
    (home / "wind.wav").write_bytes(b"RIFF")
    bpy.data.sounds.load(str(home / "wind.wav"))
    (home / "script.py").write_text("pass")
    bpy.data.texts.load(str(home / "script.py"))
    assert names() == ["gone.png", "script.py"]


def test_a_sequence_counts_whole_where_any_file_may_be_shown(home):
    for number in range(1, 4):
        (home / f"s_{number}.png").write_bytes(b"x")
    (home / "s_x.png").write_bytes(b"x")
    image = bpy.data.images.new("Sequence", 1, 1)
    image.source, image.filepath = "SEQUENCE", "//s_1.png"
    group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    node = group.nodes.new("GeometryNodeImageTexture")
    node.inputs["Image"].default_value = image  # which takes the frame from another socket
    assert names() == ["s_1.png", "s_2.png", "s_3.png"]
    bpy.data.node_groups.remove(group)
    texture = bpy.data.textures.new("Texture", "IMAGE")
    texture.image = image
    texture.image_user.frame_duration, texture.image_user.use_auto_refresh = 3, True
    assert names(2) == ["s_2.png"] and names(2, 3) == ["s_2.png", "s_3.png"]
    texture.image_user.driver_add("frame_offset")
    assert names(2) == ["s_1.png", "s_2.png", "s_3.png"], "an offset that is driven"


def test_folders_of_baked_caches_count_with_their_files(home):
    obj = add_object()
    for name in ("bakes/meta/00001.json", "points/p_000001_00.bphys", "fluid/config/config_0001.uni"):
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_bytes(b"x")
    nodes = obj.modifiers.new("Nodes", "NODES")
    nodes.node_group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    nodes.bake_directory = "//bakes"
    obj.modifiers.new("Particles", "PARTICLE_SYSTEM")
    cache = obj.particle_systems[0].point_cache
    cache.use_external, cache.filepath = True, "//points"
    found = names()
    assert {"00001.json", "p_000001_00.bphys"} <= set(found) and "config_0001.uni" not in found


def test_a_cache_folder_with_too_many_files_is_refused(home, monkeypatch):
    monkeypatch.setattr(scene_files, "MAX_CACHE_FILES", 3)
    nodes = add_object().modifiers.new("Nodes", "NODES")
    nodes.node_group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    nodes.bake_directory = "//bakes"
    (home / "bakes").mkdir()
    for number in range(4):
        (home / "bakes" / f"{number}.blob").write_bytes(b"x")
    with pytest.raises(TerrainError, match="bakes of this scene holds more than 3 files; expected"):
        names()


def test_a_color_configuration_of_the_environment_counts(home, monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)
    assert scene_files.color_config() == []
    monkeypatch.setenv("OCIO", str(home / "config.ocio"))
    assert scene_files.color_config() == [Path(home / "config.ocio")]
