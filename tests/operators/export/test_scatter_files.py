# SPDX-License-Identifier: GPL-3.0-or-later
"""`export --scatter`: the points of a frame match the instances that Blender shows."""

import csv
import json

import bpy
import numpy as np
import pytest
import store_exports
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.operators.export import scatter_files
from adaptive_terrain.operators.scatter.operators import new_scatter
from adaptive_terrain.operators.session import session


@pytest.fixture
def terrain(scene, add_terrain):
    """Turned, moved and scaled alike; its camera flies."""
    obj = add_terrain("Hills")
    obj.location, obj.rotation_euler, obj.scale = (30, -20, 5), (0.1, 0.2, 0.5), (1.3, 1.3, 1.3)
    for frame, y in ((1, -900.0), (3, -300.0)):
        scene.camera.location.y = y
        scene.camera.keyframe_insert("location", frame=frame)
    bpy.context.view_layer.update()
    for spacing, align in ((30.0, 0.5), (60.0, 0.0)):
        new_scatter(obj, spacing).adaptive_scatter.align = align
    return obj


@pytest.fixture
def export(terrain, tmp_path, capsys):
    """Run `export --scene` of the terrain; return the exit code, the output and the folder."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))

    def run(*arguments):
        code = store_exports.run("export", "--scene", tmp_path / "shot.blend", "--out", tmp_path / "out", *arguments)
        return code, capsys.readouterr(), tmp_path / "out"

    return run


def read(path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def axes(w, x, y, z):
    """float64 [n, 3, 3]: columns are where quaternions take the axes."""
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(rows).transpose(2, 0, 1)


def test_points_stand_where_blender_shows_them(export, monkeypatch):
    """Places, turns and scales are those of the instances of that frame; ids and normals those of the engine."""
    monkeypatch.setattr(scatter_files, "ROWS", 100)
    code, said, out = export("--frames", "1-3:2", "--format", "npz", "--scatter")
    assert code == 0, said.err
    names = ["Hills Scatter", "Hills Scatter.001"]
    files = [f"{bpy.path.clean_name(name)}_{frame:04d}.csv" for frame in (1, 3) for name in names]
    assert sorted(path.name for path in out.glob("*.csv")) == sorted(files)
    assert set(json.loads((out / "frame_0003.json").read_text())["files"]) == {"Hills_0003.npz", *files[2:]}
    terrain = bpy.data.objects["Hills"]
    request = session.record_of(terrain).status.request
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for name, item, file in zip(names, request.scatters.items, files[2:], strict=True):
        shown = [
            np.array(item.matrix_world)
            for item in depsgraph.object_instances
            if item.is_instance and item.parent.original.name == name
        ]
        shown, found = np.array(shown), read(out / file)
        assert len(shown) == len(found["id"]) > 100
        scale = np.linalg.norm(shown[:, :3, 2], axis=1)
        assert np.abs(found["scale"] - scale).max() < 1e-4 * scale.max()
        places = np.column_stack([found[axis] for axis in "xyz"])
        assert np.abs(places - shown[:, :3, 3]).max() < 1e-3
        grown = scale > 0.1  # of the others float32 has no axes
        turned = axes(*(found[f"rotation_{part}"] for part in "wxyz"))
        assert np.abs(turned - shown[:, :3, :3] / scale[:, None, None])[grown].max() < 1e-4
        alone = scatter_points(session.field_of(request), item.scatter, request.views, placement=request.placement)
        assert found["id"].tolist() == alone.id.tolist() and found["variant"].tolist() == alone.variant.tolist()
        up = alone.normals @ (np.array(terrain.matrix_world)[:3, :3] / 1.3).T
        assert np.abs(np.column_stack([found[f"normal_{axis}"] for axis in "xyz"]) - up).max() < 1e-5


def test_scales_of_older_files_follow_the_terrain(terrain, export, tmp_path):
    """Their node group stretches instances, so the table does too; the other scatter keeps its sizes."""
    old = terrain.children[0].modifiers[0]
    old.node_group = old.node_group.copy()
    old.node_group.name = "Adaptive Scatter"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    code, said, out = export("--frames", "1", "--format", "npz", "--scatter")
    assert code == 0, said.err
    largest = [read(path)["scale"].max() for path in sorted(out.glob("*.csv"))]
    assert 1.1 * 1.3 < max(largest) <= 1.2 * 1.3 + 1e-5 and 1.1 < min(largest) <= 1.2 + 1e-5


def test_points_are_part_of_what_resume_asks_for(export):
    """A frame without them is made again, one with them is left; without the option none are written."""
    _, _, out = export("--frames", "1", "--format", "npz")
    assert not list(out.glob("*.csv"))
    _, said, _ = export("--frames", "1", "--format", "npz", "--scatter", "--resume")
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.csv")}
    assert len(before) == 2 and "complete before" not in said.out
    _, said, _ = export("--frames", "1", "--format", "npz", "--scatter", "--resume")
    assert {path.name: path.stat().st_mtime_ns for path in out.glob("*.csv")} == before
    assert "complete before" in said.out


@pytest.mark.parametrize("scale", [(1, 2, 1), (1, 1, -1)])
def test_what_no_rotation_and_scale_can_say_is_refused(terrain, export, tmp_path, scale):
    terrain.scale = scale
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    code, said, out = export("--frames", "1", "--format", "npz", "--scatter")
    assert code == 1 and "mirrored or not scaled alike" in said.err and len(said.err.splitlines()) == 1
    assert [path.name for path in out.iterdir()] == ["Hills_0001.npz"]
