# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain whose land is shaped in Blender: its stack, and a store large enough for tiles."""

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.session import session
from rasters import store_heights


@pytest.fixture
def terrain(scene, add_terrain, store, tmp_path):
    """Return a terrain with a private copy of the store and no shaped land."""
    own = tmp_path / "hills"
    shutil.copytree(store, own)
    obj = add_terrain()
    obj.adaptive_terrain.store = str(own)
    derived_store.forget()
    derived_store.counts.update(previews=0, stores=0)
    return obj


@pytest.fixture(scope="session")
def first_shaped(tmp_path_factory):
    """Return the folder where the first test that needs it leaves a copy of the shaped land."""
    return tmp_path_factory.mktemp("shaped") / "land"


@pytest.fixture
def shaped(terrain, first_shaped):
    """Return the folder of the land of `terrain`, shaped by its stack of one entry."""
    add("scree")
    beside = land_folder.folder_beside(terrain.adaptive_terrain.store)
    if not first_shaped.exists():
        assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
        shutil.copytree(beside, first_shaped)
        derived_store.counts["stores"] = 0
    else:
        shutil.copytree(first_shaped, beside)
        session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Shaped" and derived_store.counts["stores"] == 0
    return Path(shaped_land.store_of(terrain))


def add(effect: str, **numbers):
    assert bpy.ops.adaptive_terrain.land_add(effect=effect) == {"FINISHED"}
    land = bpy.context.object.adaptive_terrain.land
    entry = land.entries[land.active]
    for name, value in numbers.items():
        setattr(getattr(entry, effect), name, value)
    return entry


def names(terrain) -> list[str]:
    return [entry.name for entry in terrain.adaptive_terrain.land.entries]


def stack_now(terrain, tmp_path):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return land_stack.stack_of(terrain.evaluated_get(depsgraph), depsgraph, tmp_path / "masks")


@pytest.fixture(scope="session")
def wide_store(tmp_path_factory):
    """Build a store with three levels; the finest is made of tiles."""
    return wide_hills(tmp_path_factory.mktemp("wide") / "hills", 1100, 1500)


def wide_hills(path, rows: int, columns: int):
    """Build a store at `path` with hills 8 m a column and 10 m a row; return `path`."""
    y, x = np.mgrid[0:rows, 0:columns]
    return store_heights(path, 60 * np.sin(x / 31) * np.cos(y / 27), 8.0, 10.0)
