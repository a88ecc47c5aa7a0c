# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the tests that need the bpy module: a surface, a store, an empty file, a scene, terrains in it."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.attributes import Attribute
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from rasters import store_heights


def make_grid_surface(columns: int, rows: int, height=lambda x, y: 0.1 * x):
    """Return the arrays of a Surface with two triangles per cell and cells of 1 m."""
    y, x = np.mgrid[0 : rows + 1, 0 : columns + 1].astype(np.float32)
    positions = np.stack([x.ravel(), y.ravel(), np.broadcast_to(height(x, y), x.shape).ravel()], 1).astype(np.float32)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    triangles = np.stack([a, b, c, a, c, d], 1).reshape(-1, 3).astype(np.int32)
    pairs = np.stack([triangles, np.roll(triangles, -1, 1)], 2).reshape(-1, 2)
    edges, corner_edges = np.unique(np.sort(pairs, 1), axis=0, return_inverse=True)
    normals = np.zeros_like(positions)
    normals[:, 0], normals[:, 2] = 0.6, 0.8
    return Surface(
        positions=positions,
        corner_verts=triangles.ravel(),
        corner_edges=corner_edges.ravel().astype(np.int32),
        edges=edges.astype(np.int32),
        attributes={
            "normals": Attribute(normals, "POINT"),
            "uv": Attribute((positions[:, :2] / max(columns, rows, 1)).astype(np.float32), "POINT"),
            "terrain_level": Attribute(np.arange(len(triangles), dtype=np.int32) % 7, "FACE"),
        },
    )


@pytest.fixture
def grid_surface():
    return make_grid_surface


@pytest.fixture
def empty():
    """Open an empty file with the extension registered; preferences stay, and no test changes them."""
    import adaptive_terrain
    import bpy

    if not hasattr(bpy.types.Object, "adaptive_terrain"):
        adaptive_terrain.register()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    """Build a small store of rolling hills: 129 x 129 samples, 10 m apart."""
    y, x = np.mgrid[0:129, 0:129]
    heights = 40 * np.sin(x / 9) * np.cos(y / 7) + 5 * np.sin(x * y / 30)
    return str(store_heights(tmp_path_factory.mktemp("stores") / "hills", heights, 10.0))


@pytest.fixture
def factory(empty):
    """Open the start-up file with its cube, lamp and camera."""
    import bpy

    bpy.ops.wm.read_homefile(use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture
def scene(empty, monkeypatch):
    """Open an empty file with a camera that looks at the middle from the south, 640 x 360 pixels.

    Kernels are compiled at their launch: the viewport's timer does not wait for them.
    """
    import bpy
    from adaptive_terrain.cbt_terrain.run import warmup

    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: True)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.clip_end = 1e5
    camera.location, camera.rotation_euler = (0.0, -900.0, 400.0), (1.15, 0.0, 0.0)
    empty.collection.objects.link(camera)
    empty.camera = camera
    empty.render.resolution_x, empty.render.resolution_y = 640, 360
    return empty


@pytest.fixture
def add_terrain(store):
    """Return a function that adds a terrain object with an empty mesh to the open scene."""
    import bpy

    def add(name="Terrain"):
        obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        bpy.context.scene.collection.objects.link(obj)
        obj.adaptive_terrain.enabled, obj.adaptive_terrain.store = True, store
        obj.adaptive_terrain.viewport.error_px = 1.0  # the viewport's own default is coarser
        bpy.context.view_layer.objects.active = obj
        return obj

    return add


@pytest.fixture
def imports_here(monkeypatch):
    """Let operators import a file in this process, which saves the second that a child takes to start."""
    from adaptive_terrain.cbt_terrain.importing.build_store import run_import
    from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
    from adaptive_terrain.cbt_terrain.mosaic.import_child import has_several

    def finished_job(settings, store):
        if not has_several(settings):
            run_import(settings, store)
        return ImportJob(settings, store)  # it has nothing left to do, except for several files

    monkeypatch.setattr("adaptive_terrain.cbt_terrain.importing.import_process.ImportJob", finished_job)


@pytest.fixture
def preparing(monkeypatch):
    """Simulate a first start with a quarter of the kernels compiled; `done.set()` ends it."""
    from adaptive_terrain.cbt_terrain.run import warmup

    done = threading.Event()
    current = SimpleNamespace(fraction=0.25, done=done, ready=[done, threading.Event()], stopping=threading.Event())
    monkeypatch.setattr(warmup, "_current", current)
    return current
