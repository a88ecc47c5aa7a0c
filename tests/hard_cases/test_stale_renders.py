# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 68: a background render with a stale mesh ends with an error. tests/blender tests the real program."""

import subprocess
import sys

import bpy
import pytest

RENDER = """
import os, sys, adaptive_terrain, bpy
adaptive_terrain.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
exec(sys.argv[2])
bpy.ops.render.render(animation=True, scene=scene.name)
print("the script goes on", flush=True)
os._exit(0)  # after a compositor the bpy module would wait for ever for one of its threads
"""
ON = "the script goes on"


@pytest.fixture
def blend(flight, add_terrain, tmp_path):
    """Save a terrain whose scale is 0 at frame 4, and one without a store that renders do not show."""
    terrain = add_terrain("Hills")
    for frame, scale in ((3, 1.0), (4, 0.0), (5, 1.0)):
        terrain.scale.z = scale
        terrain.keyframe_insert("scale", index=2, frame=frame)
    broken = add_terrain("Unused")
    broken.adaptive_terrain.store, broken.hide_render = "/nowhere", True
    flight.render.engine, flight.cycles.samples, flight.cycles.use_denoising = "CYCLES", 1, False
    flight.render.resolution_x = flight.render.resolution_y = 32
    flight.frame_start, flight.frame_end = 2, 6
    flight.render.filepath = str(tmp_path / "frame_")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return tmp_path / "scene.blend"


@pytest.mark.parametrize(
    ("change", "frames", "why"),
    [
        ("", [2, 3], "frame 4 is not rendered, since its mesh would be stale. The terrain 'Hills' has a scale of 0"),
        ("scene.frame_start = 5", [5, 6], ""),
        *(
            pytest.param(*change, marks=pytest.mark.thorough)
            for change in (
                ("bpy.data.objects['Hills'].adaptive_terrain.store = '/gone'", [], "no terrain store at '/gone'"),
                ("bpy.data.objects['Hills'].adaptive_terrain.camera_source = 'CHOSEN'", [], "No camera is chosen"),
                ("scene.adaptive_terrain.stop_stale_renders = False", [2, 3, 4, 5, 6], ""),
            )
        ),
    ],
)
def test_case_68_a_render_that_would_be_stale_ends(blend, change, frames, why):
    """A render stops before a stale frame with one line and exit code 1; earlier frames are whole.

    The scene can allow stale renders. A broken terrain that renders do not show stops none.
    """
    command = [sys.executable, "-c", RENDER, blend, change]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert sorted(int(path.stem[-4:]) for path in blend.parent.glob("frame_*.png")) == frames, done.stderr
    for path in blend.parent.glob("frame_*.png"):
        assert bpy.data.images.load(str(path)).pixels[:4]
    messages = [line for line in done.stderr.splitlines() if line.startswith("Adaptive Terrain:")]
    if why:
        assert done.returncode == 1 and ON not in done.stdout
        assert len(messages) == 1 and why in messages[0] and "Adaptive Terrain" not in done.stdout
    else:
        assert done.returncode == 0 and ON in done.stdout and not messages
        assert ("frame 4 is rendered with a stale mesh" in done.stdout) == (4 in frames)


COMPOSED = """
composed = bpy.data.scenes.new("Composed")
composed.render.engine, composed.cycles.samples, composed.render.filepath = "CYCLES", 1, scene.render.filepath
composed.render.resolution_x = composed.render.resolution_y = 32
composed.frame_start, composed.frame_end, composed.camera = 3, 3, scene.camera
if bpy.app.version < (5, 0):
    composed.use_nodes = True
    composed.node_tree.nodes["Render Layers"].scene = scene
else:
    tree = composed.compositing_node_group = bpy.data.node_groups.new("Composed", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers, output = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("NodeGroupOutput")
    layers.scene = scene
    tree.links.new(layers.outputs["Image"], output.inputs["Image"])
terrain, scene = bpy.data.objects["Hills"], composed
terrain.adaptive_terrain.store = {store}
bpy.app.handlers.render_post.append(lambda *_: print("triangles", len(terrain.data.polygons), flush=True))
"""


@pytest.mark.parametrize(
    "used", [pytest.param("terrain.adaptive_terrain.store", marks=pytest.mark.thorough), "'/gone'"]
)
def test_case_68_a_scene_that_a_compositor_takes_in(blend, used):
    """Terrains of another scene in the compositor are refined, though Blender announces only the rendered scene."""
    before = len(bpy.data.objects["Hills"].data.polygons)
    done = subprocess.run(
        [sys.executable, "-c", RENDER, blend, COMPOSED.format(store=used)], capture_output=True, text=True, timeout=600
    )
    pictures = list(blend.parent.glob("frame_*.png"))
    if used == "'/gone'":
        assert done.returncode == 1 and not pictures and "There is no terrain store at '/gone'" in done.stderr
    else:
        assert done.returncode == 0 and len(pictures) == 1, done.stderr
        counts = {int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("triangles")}
        assert counts and before not in counts
