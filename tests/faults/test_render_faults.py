# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that run out of disk: Blender does not say so, and a picture under its final name is whole all the same."""

import os

import pytest
from blender_scenes import add_terrain, empty, preparing, scene, store  # noqa: F401

pytestmark = pytest.mark.skipif(os.name != "posix", reason="mounts are those of POSIX")


def test_a_full_disk_leaves_the_picture_that_stands(scene, add_terrain, tmp_path, small_disk, run_command):  # noqa: F811
    import bpy

    add_terrain("Hills").adaptive_terrain.render.error_px = 8.0
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    shot = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    disk = small_disk(3 << 20)
    render = "render", "--scene", shot, "--frames", "1", "--out", disk
    assert run_command(*render).returncode == 0
    before = (disk / "frame_0001.png").read_bytes()
    assert len(before) > 4 * 4096
    left = os.statvfs(disk)
    (disk / "other").write_bytes(bytes(left.f_bavail * left.f_bsize - 3 * 4096))
    done = run_command(*render)
    assert done.returncode == 1 and "frame_0001.png cannot be written (No space left" in done.stderr, done.stderr
    assert (disk / "frame_0001.png").read_bytes() == before and not list(disk.glob(".partial-*"))
