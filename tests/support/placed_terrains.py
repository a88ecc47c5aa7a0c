# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrains of small files with a place on Earth, in the open scene."""

import bpy
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.importing.shared_origin import place_terrain
from rasters import hills, write_raster


def add(path, crs, transform, name, heights=None):
    """Import a file as File > Import does; return the new terrain."""
    file = write_raster(path / f"{name}.tif", hills() if heights is None else heights, crs=crs, transform=transform)
    bpy.ops.mesh.adaptive_terrain_from_file(filepath=str(file))
    bpy.context.view_layer.update()
    return bpy.context.object


def placed(path, crs, transform, name, heights=None):
    """Import a file in this process, which is faster, and place the new terrain as the operator does."""
    file = write_raster(path / f"{name}.tif", hills() if heights is None else heights, crs=crs, transform=transform)
    run_import(ImportSettings(str(file)), path / name)
    obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    bpy.context.scene.collection.objects.link(obj)
    obj.adaptive_terrain.enabled, obj.adaptive_terrain.store = True, str(path / name)
    assert place_terrain(obj, bpy.context.scene, imported_of(obj.adaptive_terrain)) == []
    bpy.context.view_layer.update()
    return obj
