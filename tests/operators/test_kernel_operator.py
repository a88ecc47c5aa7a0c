# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that wait for their kernels after a click, beside the window."""

from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.run import launch, warmup
from adaptive_terrain.operators.export.bake_terrain import BakeTerrain
from adaptive_terrain.operators.export.export_terrain import ExportTerrain
from adaptive_terrain.operators.export.export_tiles import ExportHeightTiles
from adaptive_terrain.operators.ground import pick_ground
from adaptive_terrain.operators.ground.add_collider import AddCollider
from adaptive_terrain.operators.ground.drop_to_ground import BOUNDS, DropToGround
from adaptive_terrain.operators.ground.keep_above import KeepAboveGround
from adaptive_terrain.operators.ground.pick_ground import PickGround
from adaptive_terrain.operators.ground.viewshed import Viewshed
from ground_scenes import cube, only
from modal_runs import RunningOperator, running, to_the_end, turn

DROP = {"anchor": BOUNDS, "offset": 0.0, "align": True, "keep": False}
OPERATORS = {
    DropToGround: DROP,
    KeepAboveGround: {"clearance": 2.0},
    Viewshed: {"target_height": 0.0, "radius": 0.0, "attribute": False},
    AddCollider: {"rigid_body": False},
    BakeTerrain: {},
    ExportTerrain: {"is_chosen": True, "options": SimpleNamespace(is_invoke=True)},
}


@pytest.fixture
def click(askew, tmp_path, monkeypatch):
    """Return a function that clicks on an operator while `ask` says that kernels are missing twice."""
    rock, answers, asked = cube("Rock", (80.0, -20.0, 0.0)), iter([False, False]), set()
    only(rock)

    def ask(modules):
        asked.update(module.__name__ for module in modules)
        return next(answers, True)

    def start(operator_class):
        is_ground = operator_class in (DropToGround, KeepAboveGround, Viewshed)
        bpy.context.view_layer.objects.active = obj = rock if is_ground else askew
        askew.adaptive_terrain.bake_fit = True
        operator = running(operator_class, obj, filepath=str(tmp_path / "a.ply"), **OPERATORS[operator_class])
        return operator, asked

    monkeypatch.setattr(warmup, "prepare_modules", ask)
    return start


@pytest.mark.parametrize("operator_class", OPERATORS)
def test_a_click_waits_for_kernels_beside_the_window(click, operator_class, monkeypatch):
    """Whatever it launches was prepared before: nothing is compiled in the window's thread."""
    known = {module.__name__ for module in [*warmup.kernel_modules(), *warmup.overlay_modules()]}
    launched, load = set(), launch._load
    monkeypatch.setattr(launch, "_load", lambda kernel: (launched.add(kernel.module.name), load(kernel)))
    operator, asked = click(operator_class)
    assert operator.began == {"RUNNING_MODAL"} and not launched
    assert to_the_end(operator) == {"FINISHED"} and launched and launched <= known | asked


def test_a_second_click_does_not_carry_out_twice(click):
    first, _ = click(BakeTerrain)
    second, _ = click(BakeTerrain)
    assert (first.began, second.began) == ({"RUNNING_MODAL"}, {"CANCELLED"})
    assert to_the_end(first) == {"FINISHED"}
    assert [obj.name for obj in bpy.data.objects if "baked" in obj.name] == ["Askew baked"]


def test_it_acts_on_the_object_of_the_click(click):
    """A panel's button names the terrain though another object is active, but only during the click."""
    operator, _ = click(BakeTerrain)
    operator.context.object = bpy.data.objects["Rock"]
    assert to_the_end(operator) == {"FINISHED"} and "Askew baked" in bpy.data.objects


def test_a_click_that_picks_the_ground_waits_for_kernels(click, monkeypatch):
    """The eyedropper shows at once; the wait begins with the click on the terrain."""
    monkeypatch.setattr(pick_ground, "_ray_under", lambda *_: ((0.0, 0.0, 9000.0), (0.0, 0.0, -1.0)))
    launched, load = set(), launch._load
    monkeypatch.setattr(launch, "_load", lambda kernel: (launched.add(kernel.module.name), load(kernel)))
    drop, _ = click(DropToGround)
    drop.cancel(drop.context)
    answers = iter([False, False, False])
    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: next(answers, True))
    operator = RunningOperator(operator_class=PickGround, report=Mock(), moves="CURSOR", context=drop.context)
    operator.context.window_manager.reset_mock()
    operator.context.area, operator.context.window = SimpleNamespace(type="VIEW_3D"), Mock()
    operator.context.workspace = Mock()
    bpy.context.scene.cursor.location = (0.0, 0.0, -5.0)
    assert operator.invoke(operator.context, None) == {"RUNNING_MODAL"}
    assert turn(operator, "MOUSEMOVE") == {"PASS_THROUGH"}
    assert turn(operator, "LEFTMOUSE") == {"RUNNING_MODAL"} and not launched
    operator.context.window.cursor_modal_restore.assert_called_once()
    assert to_the_end(operator) == {"FINISHED"} and launched
    operator.context.window_manager.modal_handler_add.assert_called_once()  # Blender crashes with two
    assert bpy.context.scene.cursor.location.z > 0.0


def test_a_removed_object_ends_the_wait(click, askew):
    operator, _ = click(AddCollider)
    bpy.data.objects.remove(askew)
    operator.context.object = None
    assert to_the_end(operator) == {"CANCELLED"}


@pytest.mark.parametrize("operator_class", [ExportTerrain, ExportHeightTiles])
def test_cancelling_a_file_dialog_ends_nothing(operator_class):
    """Blender calls `cancel` of an operator that has only opened the dialog."""
    operator = SimpleNamespace(**{name: getattr(operator_class, name, None) for name in ("timer", "job")})
    operator_class.cancel(operator, None)
