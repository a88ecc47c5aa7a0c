# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Water shows water by one click, at a level that the user can change and that an update keeps."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.run import launch, warmup
from adaptive_terrain.cbt_terrain.scatter.tile import tile
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.land.water_object import LEVEL
from adaptive_terrain.operators.land.water_surface import AddWaterSurface
from adaptive_terrain.operators.scatter import starter
from blender_meshes import positions
from modal_runs import running, to_the_end, turn


def ground_of(terrain) -> np.ndarray:
    from adaptive_terrain.operators.session import session

    return session.open_field(terrain.adaptive_terrain.store).heights()


def test_a_coast_has_its_sea_at_zero(scene, add_terrain):
    terrain = add_terrain()
    assert (ground_of(terrain) < 0.0).mean() > 0.01
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    [water] = terrain.children
    assert (np.abs(positions(water)[:, 2]) < 1e-3).mean() > 0.5 and LEVEL not in water


def test_an_update_keeps_the_chosen_level(scene, add_terrain):
    terrain = add_terrain()
    level = float(np.quantile(ground_of(terrain), 0.4))
    assert bpy.ops.adaptive_terrain.water_surface(level=level) == {"FINISHED"}
    [water] = terrain.children
    assert (np.abs(positions(water)[:, 2] - level) < 1e-3).mean() > 0.5
    terrain.adaptive_terrain.vertical_scale = 2.0
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    assert list(terrain.children) == [water] and water[LEVEL] == pytest.approx(level)
    assert (np.abs(positions(water)[:, 2] - 2.0 * level) < 2e-3).mean() > 0.5


@pytest.fixture
def click(monkeypatch):
    """Return a function that clicks the button in a window."""
    monkeypatch.setattr(AddWaterSurface, "properties", SimpleNamespace(is_property_set=lambda _name: False), False)
    return lambda terrain: running(AddWaterSurface, terrain)


def test_a_click_waits_for_kernels_beside_the_window(scene, add_terrain, click, monkeypatch):
    terrain, asked, launched = add_terrain(), [], set()
    known = [module.__name__ for module in [*warmup.kernel_modules(), *warmup.overlay_modules()]]
    load, is_prepared = launch._load, iter([False, False, True])

    def ask(modules):
        asked.extend(module.__name__ for module in modules)
        return next(is_prepared)

    monkeypatch.setattr(launch, "_load", lambda kernel: (launched.add(kernel.module.name), load(kernel)))
    monkeypatch.setattr(warmup, "prepare_modules", ask)
    operator = click(terrain)
    assert operator.began == {"RUNNING_MODAL"} and not launched
    assert jobs.find(jobs.WATER, terrain).text == f"Adding water: {jobs.PREPARING}"
    assert to_the_end(operator) == {"FINISHED"} and len(terrain.children) == 1
    assert launched and not launched - {*asked, *known}, "no kernel is compiled unseen"


def test_a_cancelled_click_leaves_the_terrain_dry(scene, add_terrain, click, monkeypatch):
    terrain = add_terrain()
    monkeypatch.setattr(warmup, "prepare_modules", lambda _modules: False)
    operator = click(terrain)
    assert bpy.ops.adaptive_terrain.cancel_job(kind="WATER") == {"FINISHED"}
    assert turn(operator) == {"CANCELLED"} and not terrain.children and not jobs.running


def test_the_buttons_of_the_panel_launch_prepared_kernels(scene, add_terrain, monkeypatch):
    """A window compiles nothing at the first click of Set Up Scene, Add Water, Add Scatter and Drop to Ground."""
    tile.cache_clear()  # other tests have launched its kernel
    monkeypatch.setattr(starter, "KINDS", {"CONIFERS": starter.KINDS["CONIFERS"]})  # all take a second
    terrain, launched, load = add_terrain(), set(), launch._load
    monkeypatch.setattr(launch, "_load", lambda kernel: (launched.add(kernel.module.name), load(kernel)))
    operators = bpy.ops.adaptive_terrain
    assert operators.set_up_scene() == operators.update() == operators.water_surface() == {"FINISHED"}
    assert operators.scatter_add(kind="CONIFERS") == {"FINISHED"}
    bpy.context.view_layer.objects.active = terrain
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    scene.collection.objects.link(cube)
    cube.select_set(True)
    assert operators.drop_to_ground() == {"FINISHED"}
    known = {module.__name__ for module in [*warmup.kernel_modules(), *warmup.overlay_modules()]}
    clicks = {name.rpartition(".")[2] for name in warmup.FIRST_CLICKS}
    unused = clicks - {name.rpartition(".")[2] for name in launched}
    assert unused == {"flow", "resample"}, "layers of mountains have streams, and no file is imported"
    assert launched - known <= set(warmup.FIRST_CLICKS)
