# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames are rendered again where anything that they are made of has changed, and left alone where nothing has."""

import json
import os
import shutil
import struct
import zlib
from pathlib import Path

import bpy
import pytest
from adaptive_terrain.operators.export import file_outputs
from rasters import png_chunk
from rendered_pictures import pixels_of
from store_exports import run

RED, BLUE, GREEN = b"\xff\0\0", b"\0\0\xff", b"\0\xff\0"


def save_image(path: Path, color: bytes) -> None:
    """Write an 8 x 8 PNG of one colour, not compressed: those of all colours have the same size."""
    rows = zlib.compress((b"\0" + color * 8) * 8, 0)
    head = struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", head) + png_chunk(b"IDAT", rows) + png_chunk(b"IEND", b"")
    )


def recolor(path: Path, color: bytes) -> None:
    """Give an image another colour, and the size and the time that it had."""
    before = path.stat()
    save_image(path, color)
    assert path.stat().st_size == before.st_size
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def show_image(obj, image):
    """Give a terrain a material that glows as an image; returns its image node."""
    material = bpy.data.materials.new("Shown")
    if bpy.app.version < (5, 0, 0):  # else it has nodes
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node, glow = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeEmission")
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    node.image = image
    tree.links.new(node.outputs["Color"], glow.inputs["Color"])
    tree.links.new(glow.outputs["Emission"], out.inputs["Surface"])
    obj.data.materials.append(material)
    tree.nodes.active = node
    return node


@pytest.fixture
def shot(scene, add_terrain, store, tmp_path):
    """Save a scene of 16 x 9 pixels with one terrain, whose folder holds all that it is made of."""
    shutil.copytree(store, tmp_path / "shot" / "hills")
    path = tmp_path / "shot" / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    hills = add_terrain("Hills")
    hills.adaptive_terrain.store = "//hills"
    hills.adaptive_terrain.viewport.error_px, hills.adaptive_terrain.render.error_px = 24.0, 16.0
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "BLENDER_WORKBENCH", 16, 9
    scene.display.shading.color_type, scene.display.shading.light = "TEXTURE", "FLAT"
    bpy.ops.wm.save_mainfile()
    return path


@pytest.fixture
def resume(shot, tmp_path, capsys):
    """Return a function that renders frames with --resume and returns those that it did not find complete."""

    def rendered(frames="1", scene=shot, out=tmp_path / "out") -> list[int]:
        capsys.readouterr()
        assert run("render", "--scene", scene, "--out", out, "--frames", frames, "--resume") == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("frame ")]
        return [int(line.split()[1].rstrip(":")) for line in lines if not line.endswith("complete before")]

    return rendered


def faults_of(out: Path, frames: str, capsys) -> str:
    """Return what `verify` finds wrong; "" for nothing."""
    capsys.readouterr()
    code = run("verify", out, "--frames", frames)
    said = capsys.readouterr().err
    assert code == (1 if said else 0)
    return said


def colors_of(picture: Path) -> set[str]:
    """Return the channels that are bright in a picture's lower half."""
    pixels = pixels_of(picture)
    rows, columns = pixels.shape[:2]
    middle = pixels[: rows // 2, columns // 3 : -columns // 3, :3].mean(axis=(0, 1))
    return {name for name, value in zip("rgb", middle, strict=True) if value > 0.5}


def test_a_changed_texture_is_rendered_again(shot, resume, tmp_path, capsys):
    texture, out = shot.parent / "tex.png", tmp_path / "out"
    save_image(texture, RED)
    show_image(bpy.data.objects["Hills"], bpy.data.images.load("//tex.png"))
    bpy.ops.wm.save_mainfile()
    assert [resume(), resume()] == [[1], []] and colors_of(out / "frame_0001.png") == {"r"}
    recolor(texture, BLUE)
    assert "frame 1 is stale: ../shot/tex.png has changed since" in faults_of(out, "1", capsys)
    assert resume() == [1] and colors_of(out / "frame_0001.png") == {"b"}
    assert faults_of(out, "1", capsys) == "" and resume() == []
    moved = tmp_path / "another" / "machine" / "shot"
    moved.parent.mkdir(parents=True)
    shot.parent.rename(moved)
    assert resume(scene=moved / "shot.blend") == [], "the same scene in another folder"


def test_an_image_of_a_library_counts(shot, resume, tmp_path, capsys):
    library = shot.parent / "assets" / "rocks.blend"
    library.parent.mkdir()
    save_image(library.parent / "rock.png", RED)
    node = show_image(bpy.data.objects["Hills"], bpy.data.images.load(str(library.parent / "rock.png")))
    material = node.id_data
    material = next(m for m in bpy.data.materials if m.node_tree == material)
    node.image.filepath = "//rock.png"  # from the library's folder
    bpy.data.libraries.write(str(library), {material})
    bpy.data.objects["Hills"].data.materials.clear()
    bpy.data.materials.remove(material)
    bpy.data.images.remove(bpy.data.images["rock.png"])
    with bpy.data.libraries.load(str(library), link=True, relative=True) as (_there, here):
        here.materials = ["Shown"]
    bpy.data.objects["Hills"].data.materials.append(here.materials[0])
    bpy.ops.wm.save_mainfile()
    assert [resume(), resume()] == [[1], []] and colors_of(tmp_path / "out" / "frame_0001.png") == {"r"}
    recolor(library.parent / "rock.png", BLUE)
    assert "../shot/assets/rock.png has changed" in faults_of(tmp_path / "out", "1", capsys)
    assert [resume(), resume()] == [[1], []] and colors_of(tmp_path / "out" / "frame_0001.png") == {"b"}


def test_a_painted_layer_counts(shot, resume):
    image = bpy.data.images.new("Paint", 4, 4)
    layer = bpy.data.objects["Hills"].adaptive_terrain.layers.add()
    layer.image = image
    image.pack()
    bpy.ops.wm.save_mainfile()
    assert [resume(), resume()] == [[1], []]
    image = bpy.data.images["Paint"]
    image.pixels[0] = 1.0
    image.pack()
    bpy.ops.wm.save_mainfile()
    assert [resume(), resume()] == [[1], []]
    image = bpy.data.images["Paint"]
    image.filepath_raw, image.file_format = str(shot.parent / "paint.png"), "PNG"
    image.unpack(method="REMOVE") if image.packed_file else None
    save_image(shot.parent / "paint.png", RED)
    image.source = "FILE"
    bpy.ops.wm.save_mainfile()
    assert [resume(), resume()] == [[1], []]
    recolor(shot.parent / "paint.png", BLUE)
    assert [resume(), resume()] == [[1], []]


def test_a_changed_file_of_a_sequence_is_of_one_frame(shot, resume, tmp_path, capsys):
    for number in range(3, 8):
        save_image(shot.parent / f"s_{number:03d}.png", RED)
    image = bpy.data.images.load("//s_003.png")
    image.source = "SEQUENCE"
    node = show_image(bpy.data.objects["Hills"], image)
    user = node.image_user
    user.frame_duration, user.frame_start, user.frame_offset, user.use_auto_refresh = 3, 1, 3, True
    bpy.ops.wm.save_mainfile()
    assert [resume("1-4"), resume("1-4")] == [[1, 2, 3, 4], []]
    recolor(shot.parent / "s_005.png", BLUE)
    assert faults_of(tmp_path / "out", "1-4", capsys).count("is stale") == 1
    assert [resume("1-4"), resume("1-4")] == [[2], []]
    recolor(shot.parent / "s_006.png", GREEN)
    assert [resume("1-4"), resume("1-4")] == [[3, 4], []], "the last file stays"
    recolor(shot.parent / "s_003.png", BLUE)
    assert resume("1-4") == []
    shown = [colors_of(tmp_path / "out" / f"frame_000{frame}.png") for frame in (1, 2, 3, 4)]
    assert shown == [{"r"}, {"b"}, {"g"}, {"g"}]


@pytest.mark.parametrize("cyclic", [False, True])
def test_a_sequence_counts_with_the_file_that_blender_shows(shot, resume, tmp_path, cyclic):
    """Compare the listed file with the picture, before the sequence, within it and after."""
    colors = {number: color for number, color in zip(range(9, 13), (RED, GREEN, BLUE, b"\xff\xff\0"), strict=True)}
    for number, color in colors.items():
        save_image(shot.parent / f"v2_{number:02d}_x.png", color)
    image = bpy.data.images.load("//v2_09_x.png")
    image.source = "SEQUENCE"
    user = show_image(bpy.data.objects["Hills"], image).image_user
    user.frame_duration, user.frame_start, user.frame_offset = 3, 2, 9
    user.use_auto_refresh, user.use_cyclic = True, cyclic
    bpy.ops.wm.save_mainfile()
    resume("-1-6")
    out = tmp_path / "out"
    for frame in range(-1, 7):
        [name] = [n for n in json.loads((out / f"frame_{frame:04d}.json").read_text())["inputs"] if n.endswith("x.png")]
        channels = colors[int(Path(name).name.split("_")[1])]
        bright = {channel for channel, value in zip("rgb", channels, strict=True) if value}
        assert colors_of(out / f"frame_{frame:04d}.png") == bright, (frame, name)


def add_output(scene, folder: str):
    """Let the compositor pass the picture on, and write it to a folder too; returns the File Output node."""
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        end = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        end = tree.nodes.new("CompositorNodeComposite")
    layers, node = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeOutputFile")
    tree.links.new(layers.outputs["Image"], end.inputs[0])
    if hasattr(node, "directory"):
        node.directory, node.file_name = folder, "extra_"
        node.file_output_items.new("RGBA", "Image")
        node.format.media_type = "IMAGE"
        node.format.file_format = "PNG"
    else:
        node.base_path = folder
    tree.links.new(layers.outputs["Image"], node.inputs[0])
    return node


def outputs_in(folder: Path) -> list[Path]:
    return sorted(file for file in folder.rglob("*") if file.is_file())


@pytest.mark.parametrize(
    "folder",
    [
        *(pytest.param(path, marks=pytest.mark.thorough) for path in ("//layers/", "//../layers")),
        "/",
        "//layers/{blend_name}/",
    ],
)
def test_files_of_file_output_nodes_are_part_of_a_frame(shot, resume, tmp_path, capsys, folder):
    if "{" in folder and bpy.app.version < (4, 5, 0):
        pytest.skip("this Blender fills in nothing")
    place = shot.parent / "layers"
    if folder.startswith("//.."):
        place = tmp_path / "layers"
    elif folder == "/":
        place = tmp_path / "absolute"
        folder = str(place)
    add_output(bpy.context.scene, folder)
    bpy.ops.wm.save_mainfile()
    assert [resume("1-2"), resume("1-2")] == [[1, 2], []]
    files = outputs_in(place)
    assert len(files) == 2 and all(file.read_bytes().startswith(b"\x89PNG") for file in files), files
    if "{" in folder:
        assert {file.parent.name for file in files} == {"shot"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        f"frame_000{frame}.{suffix}" for frame in (1, 2) for suffix in ("png", "json")
    }
    summary = json.loads((tmp_path / "out" / "frame_0002.json").read_text())
    assert sorted(summary["files"]) == sorted(["frame_0002.png", os.path.relpath(files[1], tmp_path / "out")])
    files[1].unlink()
    assert f"frame 2: {os.path.relpath(files[1], tmp_path / 'out')} is missing" in faults_of(
        tmp_path / "out", "1-2", capsys
    )
    assert [resume("1-2"), resume("1-2")] == [[2], []] and outputs_in(place) == files
    files[0].write_bytes(files[0].read_bytes()[:-1] + b"x")
    assert [resume("1-2"), resume("1-2")] == [[1], []]
    nodes = file_outputs.output_nodes(bpy.context.scene)
    assert [file_outputs.node_folder(node) for node in nodes] == [folder], "the open file keeps its own"


def test_the_picture_of_another_frame_is_no_frame(shot, resume, tmp_path, capsys):
    camera = bpy.context.scene.camera
    for frame, x in ((1, 0.0), (2, 300.0)):
        camera.location.x = x
        camera.keyframe_insert("location", index=0, frame=frame)
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "out"
    assert resume("1-2") == [1, 2]
    shutil.copy(out / "frame_0002.png", out / "frame_0001.png")
    assert "frame 1: frame_0001.png" in faults_of(out, "1-2", capsys)
    assert [resume("1-2"), resume("1-2")] == [[1], []]
    shutil.copy(out / "frame_0002.json", out / "frame_0001.json")
    assert "frame 1: frame_0001.json is damaged" in faults_of(out, "1-2", capsys)
    assert [resume("1-2"), resume("1-2")] == [[1], []]


def test_other_settings_of_the_scene_render_again(shot, resume):
    assert [resume(), resume()] == [[1], []]
    for change in ({"resolution_x": 18}, {"resolution_percentage": 50}, {"filter_size": 2.0}):
        for name, value in change.items():
            setattr(bpy.context.scene.render, name, value)
        bpy.ops.wm.save_mainfile()
        assert [resume(), resume()] == [[1], []], change


def test_layers_of_one_file_and_nodes_in_groups_are_found(shot, resume, tmp_path):
    scene = bpy.context.scene
    node = add_output(scene, "//layers/all_")
    tree = node.id_data
    if hasattr(node, "directory"):
        node.directory, node.file_name = "//layers", "all_"
        node.format.media_type = "MULTI_LAYER_IMAGE"
    node.format.file_format = "OPEN_EXR_MULTILAYER"
    group = bpy.data.node_groups.new("Inner", "CompositorNodeTree")
    group.interface.new_socket("Image", in_out="INPUT", socket_type="NodeSocketColor")
    begin, inner = group.nodes.new("NodeGroupInput"), group.nodes.new("CompositorNodeOutputFile")
    if hasattr(inner, "directory"):
        inner.directory, inner.file_name = "//inner#", "##of_"
        inner.file_output_items.new("RGBA", "Image")
        inner.format.media_type = "IMAGE"
    else:
        inner.base_path, inner.file_slots[0].path = "//inner#", "##of_Image"
    group.links.new(begin.outputs[0], inner.inputs[0])
    outer = tree.nodes.new("CompositorNodeGroup")
    outer.node_tree = group
    layers = next(other for other in tree.nodes if other.type == "R_LAYERS")
    tree.links.new(layers.outputs["Image"], outer.inputs[0])
    bpy.ops.wm.save_mainfile()
    assert [resume("7-8"), resume("7-8")] == [[7, 8], []]
    found = {str(path.relative_to(shot.parent)) for path in outputs_in(shot.parent) if path.suffix in (".png", ".exr")}
    assert found == {f"layers/all_000{frame}.exr" for frame in (7, 8)} | {f"inner#/0{n}of_Image.png" for n in (7, 8)}
    assert sorted(path.name for path in file_outputs.output_folders(bpy.context.scene)) == ["layers", shot.parent.name]


def test_a_path_that_blender_cuts_short_is_refused(shot, tmp_path, capsys):
    add_output(bpy.context.scene, "//" + "layers/" * 130)
    bpy.ops.wm.save_mainfile()
    assert run("render", "--scene", shot, "--out", tmp_path / "out", "--frames", "1") == 1
    assert "File Output node 'File Output' is too long" in capsys.readouterr().err
    assert [path for path in outputs_in(tmp_path / "out") if path.suffix != ".json"] == []


def test_folders_outside_the_scene_are_named(shot, tmp_path, capsys):
    add_output(bpy.context.scene, str(tmp_path / "elsewhere") + "/")
    bpy.ops.wm.save_mainfile()
    assert run("render", "--scene", shot, "--out", tmp_path / "out", "--frames", "1") == 0
    assert f"outside the scene's folder, to {tmp_path / 'elsewhere'}" in capsys.readouterr().err
    assert len(list((tmp_path / "elsewhere").iterdir())) == 1


def test_a_name_that_leaves_its_folder_is_refused(shot, tmp_path, capsys):
    node = add_output(bpy.context.scene, "//layers/")
    if hasattr(node, "directory"):
        node.file_name = "../escaped_"
    else:
        node.file_slots[0].path = "../escaped_"
    bpy.ops.wm.save_mainfile()
    assert run("render", "--scene", shot, "--out", tmp_path / "out", "--frames", "1") == 1
    assert "which leads out of its folder" in capsys.readouterr().err
    assert not list(tmp_path.rglob("escaped_*"))


def test_a_frame_that_is_not_rendered_leaves_no_other_files(shot, tmp_path, capsys):
    hills = bpy.data.objects["Hills"]
    for frame, scale in ((1, 1.0), (2, 0.0)):
        hills.scale.z = scale
        hills.keyframe_insert("scale", index=2, frame=frame)
    add_output(bpy.context.scene, "//layers/")
    bpy.ops.wm.save_mainfile()
    assert run("render", "--scene", shot, "--out", tmp_path / "out", "--frames", "1-2") == 1
    assert "Frame 2 is not rendered" in capsys.readouterr().err
    assert [path.stem[-4:] for path in outputs_in(shot.parent / "layers")] == ["0001"]
