# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a scene whose files are pipes: Blender would wait for their pixels, so it is not asked."""

import os

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.layers.images import numbered_files, painted_of
from adaptive_terrain.operators.maps import images as map_images
from map_scenes import bake
from map_scenes import terrain as terrain_with_maps  # noqa: F401
from store_exports import run
from time_limit import time_limit


def image_in(path, source="FILE"):
    """Return an image whose file was there when Blender loaded it, and is a pipe now."""
    image = bpy.data.images.new("Rock", 4, 4)
    image.filepath_raw = str(path).replace("<UDIM>", "1001")
    image.file_format = "PNG"
    image.save()
    bpy.data.images.remove(image)
    image = bpy.data.images.load(str(path).replace("<UDIM>", "1001"))
    image.source = source
    if source == "TILED":
        image.filepath = str(path)
    return image


@pytest.mark.parametrize(
    ("name", "source", "pipe"),
    [
        ("a.png", "FILE", "a.png"),
        ("a.<UDIM>.png", "TILED", "a.1001.png"),
        ("a.<UDIM>.png", "TILED", "a.1002.png"),
        ("a_0001.png", "SEQUENCE", "a_0002.png"),
    ],
)
def test_pixels_of_a_pipe_are_not_requested(name, source, pipe, empty, tmp_path):
    image = image_in(tmp_path / name, source)
    (tmp_path / pipe).unlink(missing_ok=True)
    os.mkfifo(tmp_path / pipe)
    with time_limit(20), pytest.raises(TerrainError, match=r"'a.*png' of a mask is .*pipe.*; expected an image file"):
        painted_of(image, "of a mask")


@pytest.mark.parametrize("source", ["TILED", "SEQUENCE", "MOVIE", "FILE"])
def test_a_name_that_is_too_long_has_no_files(source, tmp_path):
    assert numbered_files(tmp_path / f"{'n' * 300}.png", source) == []
    assert numbered_files(tmp_path / ("n" * 300) / "a.1001.png", source) == []


def test_a_scene_that_names_a_pipe_is_refused(scene, add_terrain, tmp_path, capsys):
    add_terrain()
    image = image_in(tmp_path / "a.png")
    image.use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    (tmp_path / "a.png").unlink()
    os.mkfifo(tmp_path / "a.png")
    argv = "export", "--scene", tmp_path / "scene.blend", "--frames", "1", "--format", "npz", "--out", tmp_path / "out"
    with time_limit(30):
        code = run(*argv)
    message = capsys.readouterr().err
    assert code == 1 and "names" in message and "a.png, a pipe, a socket or a device; expected a file" in message


def test_a_baked_map_that_is_a_pipe_is_not_loaded(terrain_with_maps, tmp_path):  # noqa: F811
    bake(terrain_with_maps)
    folder = map_images.map_folder(terrain_with_maps)
    [name] = {file.name for file in folder.glob("detail_normal*")}
    for image in list(bpy.data.images):
        bpy.data.images.remove(image)
    (folder / name).rename(folder / "aside")
    os.mkfifo(folder / name)
    with time_limit(20):
        assert map_images.map_image(terrain_with_maps, "detail_normal") is None
    os.replace(folder / "aside", folder / name)
    assert map_images.map_image(terrain_with_maps, "detail_normal") is not None


def test_a_preset_whose_image_is_a_pipe_is_applied_without_it(scene, add_terrain, tmp_path):
    from adaptive_terrain.cbt_terrain.height_operators.mask import HeightMask
    from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack

    os.mkfifo(tmp_path / "mask.png")
    land = add_terrain().adaptive_terrain.land
    with time_limit(20):
        left_out = land_stack.fill(land, Stack((Entry("snow", mask=HeightMask(str(tmp_path / "mask.png"), (), 1.0)),)))
    assert len(left_out) == 1 and "mask.png of its mask cannot be read" in left_out[0]
