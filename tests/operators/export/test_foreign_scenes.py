# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of other people, and projects that were moved: nothing in a scene runs, and its files are found."""

import shutil

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from rasters import hills, write_raster
from store_exports import run

pytestmark = pytest.mark.usefixtures("imports_here")


def export(blend, out, *options) -> int:
    return run("export", "--scene", blend, "--frames", "1", "--format", "npz", "--out", out, *options)


@pytest.mark.parametrize("verb", ["export", "prepare", "submit", "effects"])
def test_scripts_and_drivers_of_a_scene_do_not_run(scene, add_terrain, tmp_path, capsys, verb):
    """Whatever verb opens it: a text that registers itself, a driver of an object, a driver of a setting."""
    obj = add_terrain()
    mark = tmp_path / "ran"
    text = bpy.data.texts.new("evil.py")
    text.from_string(f"open({str(mark)!r}, 'a').write('x')")
    text.use_module = True
    for owner, path, index in ((obj, "location", 2), (obj.adaptive_terrain, "vertical_scale", -1)):
        driver = owner.driver_add(path, index).driver
        driver.expression = f"1 + 0 * __import__('builtins').open({str(mark)!r}, 'a').write('x')"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    mark.unlink(missing_ok=True)
    argv = [verb, "--scene", tmp_path / "scene.blend"]
    argv += {"export": ["--frames", "1", "--format", "npz"], "prepare": ["--frames", "1"]}.get(verb, [])
    argv += ["--out", tmp_path / "out"] if verb in ("export", "submit") else []
    code = run(*argv)
    assert code in (0, 1) and "Traceback" not in capsys.readouterr().err
    assert not mark.exists()


def test_a_moved_project_gives_the_same_mesh(scene, add_terrain, tmp_path, capsys, monkeypatch):
    """Names with spaces and other letters; then without the height map; then without the store."""
    project = tmp_path / "Projekt Ä 1"
    project.mkdir()
    transform = (10.0, 0.0, 6e5, 0.0, -10.0, 5.2e6)
    write_raster(project / "höhen 01.tif", hills(), crs="EPSG:32632", transform=transform)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "szene ü.blend"))
    settings = add_terrain().adaptive_terrain
    settings.store, settings.source, settings.source_path = "", "FILE", "//höhen 01.tif"
    settings.render.error_m = 0.1  # the camera sees other ground
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    assert settings.store.startswith("//")
    bpy.ops.wm.save_mainfile()
    assert export(project / "szene ü.blend", tmp_path / "first") == 0, capsys.readouterr().err
    moved = tmp_path / "moved (copy) 100%"
    project.rename(moved)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert export("../moved (copy) 100%/szene ü.blend", "out dir") == 0, capsys.readouterr().err
    (moved / "höhen 01.tif").unlink()
    assert export(moved / "szene ü.blend", tmp_path / "third") == 0, capsys.readouterr().err
    first, *others = (
        read_npz(next(folder.glob("*.npz")))
        for folder in (tmp_path / "first", tmp_path / "elsewhere" / "out dir", tmp_path / "third")
    )
    assert len(first["triangles"]) > 100
    for other in others:
        assert all(np.array_equal(first[name], other[name]) for name in ("positions", "triangles"))
    capsys.readouterr()
    shutil.rmtree(moved / "terrain")
    assert export(moved / "szene ü.blend", tmp_path / "last") == 1
    [error] = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert "terrain" in error and "moved (copy) 100%" in error
