# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that openjd-cli runs with a program instead of Blender, and scenes whose terrains have no complete store."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing import refining
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.operators.farm import bundle
from adaptive_terrain.operators.importing import import_terrain
from mathutils import Vector
from rasterio.transform import from_origin
from rasters import hills, write_raster
from worker_program import worker_program

# Stands for Blender: runs verbs with small tiles, and imports in its own process. It dies after its first tile if told.
WORKER = """
import contextlib, os
from pathlib import Path
from adaptive_terrain.cbt_terrain.importing import build_store, import_work, refining, tile_crew, tile_tasks
from adaptive_terrain.cbt_terrain.importing.source_list import names_several
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters import raster
from adaptive_terrain.cbt_terrain.tiling import part_files
from adaptive_terrain.operators.cli import command_line
refining.FEWEST, refining.FACTOR, refining.BITS = 1, 2, 4
import_work.TILE_BITS = 4
tile_crew.MIN_BYTES = 1
raster.BLOCK_SAMPLES = 1
write_ahead, writing_part = tile_tasks.write_ahead, part_files.writing_part

def write_and_die(*tile):
    write_ahead(*tile)
    if os.environ.get("DIE") == "ahead":
        os._exit(9)

def import_source(settings, store, _on_progress=None, part=None):
    one_or_several = run_mosaic_import if names_several(settings) else build_store.run_import
    return one_or_several(settings, Path(store), part=part)

@contextlib.contextmanager
def write_part_and_die(folder, kind, number):
    with writing_part(folder, kind, number) as writer:
        yield writer
    if os.environ.get("DIE") == kind:
        os._exit(9)

tile_tasks.write_ahead = write_and_die
part_files.writing_part = write_part_and_die
from adaptive_terrain.operators.blender import need_bpy
need_bpy("A worker")
from adaptive_terrain.operators.export import preparing
from adaptive_terrain.operators.importing import shot_import, shot_tiles
preparing.import_source = shot_tiles.import_source = shot_import.import_source = import_source

def work(arguments):
    return command_line.main(arguments[2:]) if "--command" in arguments else 0  # the guard
"""


@pytest.fixture
def shot(scene, add_terrain, tmp_path, monkeypatch):
    """Save a scene whose terrain has a first picture; its camera looks down at another place in each of four frames."""
    for name, value in (("FEWEST", 1), ("FACTOR", 2), ("BITS", 4)):
        monkeypatch.setattr(refining, name, value)
    place = from_origin(5e5, 5e6, 10, 10)
    source = write_raster(tmp_path / "a.tif", hills(200, 150), crs="EPSG:32632", transform=place)
    obj = add_terrain()
    settings = obj.adaptive_terrain
    settings.source, settings.source_path, settings.store = "FILE", str(source), str(tmp_path / "own.store")
    monkeypatch.chdir(tmp_path)
    run_import(replace(import_terrain.settings_of(obj), source="a.tif", quick=600), tmp_path / "own.store")
    settings.render.error_px = 0.4 * open_store(tmp_path / "own.store").max_height
    scene.camera.rotation_euler, scene.camera.data.angle = (0.0, 0.0, 0.0), 0.9
    for frame, (x, y) in enumerate(((-600.0, -300.0), (-200.0, 400.0), (300.0, -300.0), (700.0, 400.0)), start=1):
        scene.camera.location = obj.matrix_world @ Vector((x, y, 900.0))
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    scene.frame_start, scene.frame_end = 1, 4
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    settings.store = "//own.store"
    bpy.ops.wm.save_mainfile()
    return tmp_path


@pytest.fixture(scope="module")
def worker(tmp_path_factory):
    with worker_program(tmp_path_factory.mktemp("worker") / "blender", WORKER) as program:
        yield program


@pytest.fixture
def start(tmp_path, worker):
    """Return a function that starts openjd-cli on a step of the job in tmp_path."""
    values = f"file://{tmp_path / 'job' / bundle.OPENJD_VALUES}"

    def started(step, *arguments, **variables):
        command = [Path(sys.executable).with_name("openjd"), "run", tmp_path / "job" / bundle.TEMPLATE, "--step", step]
        command += [*arguments, "--job-param", values, "--job-param", f"Blender={worker}"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen(command, env=os.environ | variables, **pipes)

    return started


@pytest.fixture
def two_shares(monkeypatch):
    monkeypatch.setattr(bundle, "MAX_SHARES", 2)
    monkeypatch.setattr(bundle, "SHARE_TILES", 1)


def ended(process):
    report = process.communicate(timeout=600)[0]
    return process.returncode, report


def share(number):
    return "--tasks", json.dumps([{"Share": str(number)}])


def num_parts(store, kind):
    """Return the number of units or tiles that workers have done in the work of a store."""
    return len(list(store.glob(f"data-*/{kind}-*.part")))
