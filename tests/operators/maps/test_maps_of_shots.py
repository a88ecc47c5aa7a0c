# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps as fine as a shot needs: every frame is looked at, beside the window."""

import time

import bpy
import pytest
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.maps import images as map_images
from adaptive_terrain.operators.maps import request as map_request
from adaptive_terrain.operators.maps.operators import BakeMaps
from map_scenes import bake, keys
from modal_runs import running, to_the_end, turn


def test_a_shot_is_looked_at_beside_the_window(terrain):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 5
    scene.frame_set(3)
    terrain.adaptive_terrain.maps.frames = "SHOT"
    operator = running(BakeMaps, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert jobs.find(jobs.BAKE) is not None
    assert to_the_end(operator) == {"FINISHED"} and not jobs.running
    assert scene.frame_current == 3 and len(keys(terrain)) == 1


def test_a_shot_is_looked_at_from_every_frame(terrain):
    """Also from that which the scene is at."""
    scene = bpy.context.scene
    for frame in range(1, 6):
        scene.camera.location.x = 10.0 * frame
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 5
    for now in ((3, 0.0), (5, 0.25)):
        scene.frame_set(now[0], subframe=now[1])
        terrain.adaptive_terrain.maps.frames = "SHOT"
        *_, request = map_request.visit_for_request(terrain, scene)
        east = [-float(view.world_to_camera[0, 3]) for view in request.views]
        assert east == pytest.approx([10.0, 20.0, 30.0, 40.0, 50.0])
        assert (scene.frame_current, scene.frame_subframe) == now


def test_the_whole_terrain_needs_no_camera(terrain):
    bpy.context.scene.camera, terrain.adaptive_terrain.maps.frames = None, "WHOLE"
    bake(terrain)
    terrain.adaptive_terrain.maps.frames = "FRAME"
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.adaptive_terrain.bake_maps()


def test_removing_the_terrain_ends_its_bake(terrain):
    bpy.context.scene.frame_end = 100_000
    terrain.adaptive_terrain.maps.frames = "SHOT"
    operator = running(BakeMaps, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    turn(operator)
    bpy.data.objects.remove(terrain)
    assert to_the_end(operator) == {"CANCELLED"} and not jobs.running
    assert bpy.context.scene.frame_current == 1


def test_escape_leaves_the_maps_as_they_were(terrain, monkeypatch):
    bake(terrain)
    before = keys(terrain)
    terrain.adaptive_terrain.maps.chosen = {"detail_normal", "slope", "height"}
    progress = jobs.BackgroundJob.progress

    def slow(self, *how_far):
        time.sleep(0.3)
        progress(self, *how_far)

    monkeypatch.setattr(jobs.BackgroundJob, "progress", slow)
    operator = running(BakeMaps, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert turn(operator) == {"PASS_THROUGH"} and turn(operator, "ESC") == {"RUNNING_MODAL"}
    assert to_the_end(operator) == {"CANCELLED"}
    folder = map_images.map_folder(terrain)
    assert keys(terrain) == before and len(list(folder.iterdir())) == 1 + len(before)
