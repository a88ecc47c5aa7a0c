# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension comes and goes without a trace."""

import gc
import subprocess
import sys

import adaptive_terrain
import bpy
import pytest
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.operators import registration


def trace():
    """Return everything that an extension can leave behind: handlers, classes, properties, timers, menu entries."""
    listed = {event: len(getattr(bpy.app.handlers, event)) for event, _ in registration.HANDLERS}
    names = [name for name in dir(bpy.types) if "adaptive_terrain" in name.lower() or "Terrain" in name]
    menu = [len(menu._dyn_ui_initialize()) for menu, _ in registration.MENU_ENTRIES]
    operators = [name for name in dir(bpy.ops.adaptive_terrain) if not name.startswith("_")]
    return listed, names, menu, operators, hasattr(bpy.types.Object, "adaptive_terrain")


@pytest.fixture
def unregistered(empty):
    adaptive_terrain.unregister()
    yield
    adaptive_terrain.register()


def test_many_times_leaves_nothing(unregistered):
    before = trace()
    assert not before[-1]
    for _ in range(20):
        adaptive_terrain.register()
        assert hasattr(bpy.types.Object, "adaptive_terrain")
        adaptive_terrain.unregister()
    assert trace() == before and gc.isenabled()


def test_registering_imports_no_kernels():
    """Every start of Blender pays for what `register` imports; Warp and the kernels would take 1.5 s of a processor."""
    script = "import sys, bpy, adaptive_terrain; adaptive_terrain.register(); "
    script += "sys.exit(any(name == 'warp' or '.kernels' in name for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", script], timeout=300).returncode == 0


def test_the_first_start_is_found_by_the_compiled_module(tmp_path, monkeypatch):
    kept = tmp_path / "kernels.pyc"
    monkeypatch.setattr("importlib.util.cache_from_source", lambda source: str(kept) if "kernels" in source else "")
    assert warmup.is_first_start()
    kept.touch()
    assert not warmup.is_first_start()


def test_a_missing_warp_is_an_error_at_once(unregistered, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="warp"):
        adaptive_terrain.register()
    assert not hasattr(bpy.types.Object, "adaptive_terrain")
    monkeypatch.undo()


def test_no_class_of_a_room_is_forgotten(empty):
    kinds = "Operator", "Panel", "PropertyGroup", "Menu", "UIList", "FileHandler"
    bases = [getattr(bpy.types, kind) for kind in kinds if hasattr(bpy.types, kind)]
    here = [cls for base in bases for cls in base.__subclasses__() if cls.__module__.startswith("adaptive_terrain.")]
    assert len(here) > 100 and set(here) == set(registration.CLASSES) and all(cls.is_registered for cls in here)


def test_every_handler_is_there_once_and_survives_loading(empty, tmp_path):
    for event, handler in registration.HANDLERS:
        assert getattr(bpy.app.handlers, event).count(handler) == 1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "empty.blend"))
    for event, handler in registration.HANDLERS:
        assert getattr(bpy.app.handlers, event).count(handler) == 1


def test_a_terrain_survives_disabling_the_extension(scene, add_terrain):
    from adaptive_terrain.operators.session import session

    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 3.5
    session.update_object(terrain)
    triangles = len(terrain.data.polygons)
    adaptive_terrain.unregister()
    adaptive_terrain.register()
    assert terrain.adaptive_terrain.enabled and terrain.adaptive_terrain.viewport.error_px == 3.5
    assert len(terrain.data.polygons) == triangles > 100


def test_what_acts_on_a_terrain_says_that_it_has_none(scene):
    bpy.context.view_layer.objects.active = None
    for name in ("update", "freeze", "shape", "layer_add", "scatter_add", "bake_maps", "measure_accuracy", "land_add"):
        with pytest.raises(RuntimeError, match="Make a terrain the active object"):
            getattr(bpy.ops.adaptive_terrain, name)()


def test_no_panel_takes_the_name_of_another(empty):
    from adaptive_terrain.operators.ui import panels

    assert len({cls.bl_idname for cls in panels.CLASSES}) == len(panels.CLASSES)
