# SPDX-License-Identifier: GPL-3.0-or-later
"""A job copies only images, height maps and stores from outside the scene's folder, unless the user allows more."""

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
import yaml
from store_exports import run


@pytest.fixture
def shot(scene, add_terrain, store, tmp_path):
    """Save a scene with a store outside its folder."""
    shutil.copytree(store, tmp_path / "stores" / "hills")
    (tmp_path / "shot").mkdir()
    path = tmp_path / "shot" / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    add_terrain("Hills").adaptive_terrain.store = "//../stores/hills"
    bpy.ops.wm.save_mainfile()
    return path


@pytest.fixture
def submit(shot, tmp_path, capsys):
    """Return a function that saves and submits the scene; it returns the exit code, the output and the job's inputs."""

    def submitted(*options) -> tuple[int, str, dict]:
        bpy.ops.wm.save_mainfile()
        capsys.readouterr()
        shutil.rmtree(tmp_path / "job", ignore_errors=True)
        code = run("submit", "--scene", shot, "--out", tmp_path / "job", "--render", "--frames", "1-2", *options)
        output, assets = capsys.readouterr(), tmp_path / "job" / "asset_references.yaml"
        assert assets.exists() == (code == 0)
        inputs = yaml.safe_load(assets.read_text())["assetReferences"]["inputs"] if code == 0 else {}
        lines = [
            line for line in (output.out + output.err).splitlines(True) if not line.startswith("Info: ")
        ]  # Blender's
        return code, "".join(lines), inputs

    return submitted


def link_library(path: Path) -> None:
    """Link an object of another .blend file into the scene."""
    path.parent.mkdir(exist_ok=True)
    rig = bpy.data.objects.new("Rig", None)
    bpy.data.libraries.write(str(path), {rig})
    bpy.data.objects.remove(rig)
    with bpy.data.libraries.load(str(path), link=True) as (_there, here):
        here.objects = ["Rig"]
    bpy.context.scene.collection.objects.link(here.objects[0])


def load_text(path: Path) -> None:
    path.write_text("pass\n")
    bpy.data.texts.load(str(path))


def name_image(path: Path) -> None:
    """Let the scene name any file as an image."""
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"secret")
    bpy.data.images.new("Secret", 1, 1).use_fake_user = True
    image = bpy.data.images["Secret"]
    image.source, image.filepath = "FILE", str(path)


def link_image(path: Path) -> None:
    """Let an image inside the scene's folder be a link to another file."""
    path.write_bytes(b"secret")
    inside = Path(bpy.data.filepath).with_name("rock.png")
    inside.symlink_to(path)
    name_image(inside)


def name_height_map(path: Path) -> None:
    path.write_bytes(b"secret")
    settings = bpy.data.objects["Hills"].adaptive_terrain
    settings.store, settings.source, settings.source_path = "//missing", "FILE", str(path)


def link_in_store(path: Path) -> None:
    path.write_bytes(b"secret")
    (path.parent / "stores" / "hills" / "more.npy").symlink_to(path)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("rig.blend", link_library),
        ("driver.py", load_text),
        ("id_rsa", name_image),
        ("id_rsa", link_image),
        ("id_rsa", name_height_map),
        ("id_rsa", link_in_store),
    ],
    ids=["library", "script", "image", "link", "height map", "link in a store"],
)
def test_other_files_from_outside_need_permission(submit, tmp_path, name, make):
    path = tmp_path / name
    make(path)
    code, output, _ = submit()
    assert code == 1 and f"neither images, height maps nor stores: {path}; expected" in output
    assert "--allow-outside" in output and output.count("\n") == 1
    code, output, inputs = submit("--allow-outside")
    assert code == 0 and str(path) in output
    assert str(path) in inputs["filenames"] or make is link_in_store, "that goes with its store"


def test_files_in_the_folder_of_the_scene_need_none(submit, shot):
    link_library(shot.parent / "assets" / "rig.blend")
    load_text(shot.parent / "driver.py")
    code, output, inputs = submit()
    assert code == 0 and "rig.blend" not in output
    assert "note: the job brings 1 file or folder from outside the scene's folder: " in output
    assert {str(shot.parent / "assets" / "rig.blend"), str(shot.parent / "driver.py")} <= set(inputs["filenames"])


def test_images_and_height_maps_from_outside_are_listed(submit, tmp_path, scene, add_terrain):
    name_image(tmp_path / "textures" / "rock.PNG")
    np.save(tmp_path / "dunes.npy", np.zeros((9, 9), np.float32))
    settings = add_terrain("Dunes").adaptive_terrain
    settings.store, settings.source, settings.source_path = "//dunes", "FILE", str(tmp_path / "dunes.npy")
    code, output, inputs = submit()
    assert code == 0 and "note: the job brings 3 files and folders from outside the scene's folder: " in output
    assert all(str(tmp_path / name) in output for name in ("textures/rock.PNG", "dunes.npy", "stores/hills"))
    assert {str(tmp_path / name) for name in ("textures/rock.PNG", "dunes.npy")} <= set(inputs["filenames"])


def test_all_files_of_a_mosaic_go_with_the_job(submit, tmp_path, scene, add_terrain):
    (tmp_path / "tiles").mkdir()
    for name in ("a.tif", "b.tif", "b.tfw", "city.tif", "key.pem"):
        (tmp_path / ("tiles" if name != "city.tif" else "") / name).write_bytes(b"samples")
    settings = add_terrain("Valley").adaptive_terrain
    settings.store, settings.source, settings.source_path = "//valley", "FILE", str(tmp_path / "tiles")
    settings.more_sources.add().path = str(tmp_path / "city.tif")
    code, output, inputs = submit()
    wanted = {str(tmp_path / name) for name in ("tiles/a.tif", "tiles/b.tif", "tiles/b.tfw", "city.tif")}
    assert code == 0 and wanted <= set(inputs["filenames"]) and not any("key" in name for name in inputs["filenames"])
    bpy.data.objects["Valley"].adaptive_terrain.more_sources[0].path = str(tmp_path / "index.gti")
    (tmp_path / "index.gti").write_bytes(b"paths")
    code, output, _ = submit()
    assert code == 1 and "a tile index names its height maps: import it before you submit" in output


def test_of_many_files_ten_are_named(submit, tmp_path):
    for number in range(13):
        load_text(tmp_path / f"script_{number:02d}.py")
    code, output, _ = submit()
    assert code == 1 and "script_09.py and 3 more;" in output and "script_10.py" not in output


def test_a_folder_without_maps_is_no_folder_of_maps(submit, tmp_path, monkeypatch):
    from adaptive_terrain.operators.farm import submit as module

    (tmp_path / "private").mkdir()
    monkeypatch.setattr(module, "maps_shown_by_materials", lambda obj: {"slope"})
    bpy.data.objects["Hills"].adaptive_terrain.maps.folder = str(tmp_path / "private")
    code, output, _ = submit()
    assert code == 1 and f"nor stores: {tmp_path / 'private'};" in output
    (tmp_path / "private" / "maps.json").write_text("{}")
    assert submit()[0] == 0


def test_the_operator_asks_for_the_same_permission(shot, tmp_path):
    load_text(tmp_path / "driver.py")
    bpy.ops.wm.save_mainfile()
    asked = {"folder": str(tmp_path / "out"), "bring": False, "frames": "1"}
    with pytest.raises(RuntimeError, match="driver.py; expected them in that folder"):
        bpy.ops.adaptive_terrain.submit(**asked)
    assert bpy.ops.adaptive_terrain.submit(**asked, allow_outside=True) == {"FINISHED"}


def test_a_job_brings_the_files_of_its_frames(submit, shot):
    for number in range(1, 6):
        (shot.parent / f"s_{number:03d}.png").write_bytes(b"x")
    image = bpy.data.images.new("Sequence", 1, 1)
    image.source, image.filepath = "SEQUENCE", "//s_001.png"
    if not bpy.context.scene.world:
        bpy.context.scene.world = bpy.data.worlds.new("World")
    world = bpy.context.scene.world
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    node.image_user.frame_duration, node.image_user.frame_offset, node.image_user.use_auto_refresh = 5, 2, True
    assert {Path(name).name for name in submit()[2]["filenames"]} == {"shot.blend", "s_003.png", "s_004.png"}
