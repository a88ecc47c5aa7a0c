# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of a large height map that tests hold after its first picture and its tiles in view."""

import time
from pathlib import Path

import bpy
import pytest
from adaptive_terrain.cbt_terrain.importing import import_process, refining
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
from adaptive_terrain.cbt_terrain.sandbox.store_job import JobProgress
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.importing import import_terrain, view_tiles
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.session import session
from mathutils import Vector
from modal_runs import running, turn
from rasterio.transform import from_origin
from rasters import hills, write_raster


@pytest.fixture(name="terrain")
def large_terrain(scene, add_terrain, tmp_path, monkeypatch):
    """Add and return a turned and scaled terrain of 200 x 150 samples, of which 600 count as quick, to a saved file."""
    monkeypatch.setattr(import_terrain, "QUICK_SAMPLES", 600)
    heights = hills(200, 150)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:32632", transform=from_origin(5e5, 5e6, 10, 10))
    obj = add_terrain()
    obj.rotation_euler, obj.scale, obj.location = (0.1, 0.0, 0.7), (2.0, 2.0, 1.5), (100.0, 50.0, -200.0)
    settings = obj.adaptive_terrain
    settings.source, settings.source_path, settings.store = "FILE", str(source), ""
    scene.frame_set(7)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.context.view_layer.update()
    return bpy.data.objects["Terrain"]


def until(operator, is_reached):
    """Send timer events until a condition holds."""
    end = time.monotonic() + 300
    while not is_reached():
        assert turn(operator) == {"PASS_THROUGH"} and time.monotonic() < end
        time.sleep(0.02)


def store_of(obj):
    return Path(bpy.path.abspath(obj.adaptive_terrain.store))


class HeldImport:
    """An import that is not begun before `is_released`; those of first pictures and tiles do not wait."""

    is_released = cancelled = False

    def __init__(self, settings, store):
        self.given, self.job = (settings, store), None
        if settings.loaded_tiles:
            run_import(settings, store)  # a child would not know the sizes of this test
        if settings.quick:
            self.job = ImportJob(settings, store)

    def poll(self):
        if self.job is None and HeldImport.is_released:
            self.job = ImportJob(*self.given)
        return JobProgress(0.5, "Reading", done=self.cancelled) if self.job is None else self.job.poll()

    @property
    def reached(self):
        return (0.5, "Reading") if self.job is None else self.job.reached

    def cancel(self):
        self.cancelled = self.job is None
        if self.job is not None:
            self.job.cancel()
            self.cancelled = self.job.cancelled


def look_down(terrain, x, y, height=900.0):
    """Let the camera look down on a place of the terrain from some metres above it, and update the terrain."""
    camera = bpy.context.scene.camera
    camera.location, camera.rotation_euler = terrain.matrix_world @ Vector((x, y, height)), terrain.rotation_euler
    camera.data.angle = 0.5
    bpy.context.view_layer.update()
    if terrain.adaptive_terrain.store and imported_of(terrain.adaptive_terrain):
        session.update_object(terrain)


def tiles_of(terrain):
    """Return the numbers of a terrain's loaded tiles."""
    imported = imported_of(terrain.adaptive_terrain)
    return set(imported.settings["loaded_tiles"]) if imported is not None and imported.refined_m else set()


@pytest.fixture(name="held")
def held_import(monkeypatch, terrain):
    """Begin an import whose complete step is held, with tiles of 16 x 16 cells; return the operator of it."""
    for name, value in (("FEWEST", 1), ("FACTOR", 2), ("BITS", 4)):
        monkeypatch.setattr(refining, name, value)
    monkeypatch.setattr(view_tiles, "REST_S", 0.0)
    monkeypatch.setattr(HeldImport, "is_released", False)
    monkeypatch.setattr(import_process, "ImportJob", HeldImport)
    look_down(terrain, -600.0, -300.0)
    operator = running(import_terrain.ImportTerrain, terrain)
    until(operator, lambda: tiles_of(terrain) and jobs.find(jobs.IMPORT, terrain).message == "Reading")
    yield operator
    assert not jobs.running, "an import that is left would hold later tests"
