# SPDX-License-Identifier: GPL-3.0-or-later
"""`accuracy`: the files that it writes, what they say, and how it fails."""

import csv
import dataclasses
import errno
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import store_exports
from accuracy_rows import known_rows
from adaptive_terrain.cbt_terrain.accuracy import rows as rows_of_sweep
from adaptive_terrain.cbt_terrain.accuracy import sweep as engine_sweep
from adaptive_terrain.cbt_terrain.accuracy.cost_curve import CostCurve
from adaptive_terrain.cbt_terrain.accuracy.rows import TERMS
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.operators.accuracy import plots as accuracy_plots
from adaptive_terrain.operators.accuracy import subject as accuracy_subject
from adaptive_terrain.operators.cli import accuracy_command
from adaptive_terrain.operators.export.exporting import write_files
from browser import needs_chromium, opened
from PIL import Image

FLIGHT = {
    "clip": [1, 50000],
    "keyframes": [
        {"frame": 1, "eye": [0, -300, 90], "target": [0, 0, 0]},
        {"frame": 9, "eye": [90, -100, 60], "target": [0, 60, 0]},
    ],
}
FEW = [Setting("px", 4.0), Setting("px", 1.0), Setting("px", 1.0, meshlet=1), Setting("m", 2.0)]
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="session")
def hills(tmp_path_factory):
    """Import a store of 33 x 33 samples, 10 m apart."""
    y, x = np.mgrid[0:33, 0:33]
    folder = tmp_path_factory.mktemp("hills")
    np.save(folder / "hills.npy", (30 * np.sin(x / 4) * np.cos(y / 5)).astype(np.float32))
    command = "import", folder / "hills.npy", "--store", folder / "hills", "--extent", "320x320"
    assert store_exports.run(*command) == 0
    return folder / "hills"


@pytest.fixture
def few(monkeypatch):
    """Limit the sweep to few settings, timed once."""
    monkeypatch.setattr(engine_sweep, "RUNS", 1)
    monkeypatch.setattr(engine_sweep, "FRAME_RUNS", 1)
    monkeypatch.setattr(accuracy_subject, "settings_for", lambda heights, frame, morph: list(FEW))


@pytest.fixture
def measured(monkeypatch):
    """Replace the sweep by one with known rows."""

    def known(heights, settings, frames, *, on_row, on_progress, **_):
        for i, row in enumerate(known_rows()):
            on_progress(i / 7)
            on_row(row)
        return known_rows()

    monkeypatch.setattr(accuracy_command, "sweep", known)


@pytest.fixture
def flight(tmp_path):
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(FLIGHT))
    return path


@pytest.fixture
def accuracy(hills, tmp_path, capsys):
    """Run `accuracy` on the store of hills; returns the exit code, the output and the folder."""

    def run(*arguments, source=("--store", hills), out="out"):
        folder = tmp_path / out
        code = store_exports.run("accuracy", *source, "--out", folder, *arguments)
        return code, capsys.readouterr(), folder

    return run


def rows_of(folder):
    with (folder / "accuracy.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.thorough
def test_a_store_is_swept_from_where_all_of_it_is_seen(accuracy, monkeypatch):
    monkeypatch.setattr(rows_of_sweep, "MAX_SPREAD", math.inf)  # other programs may disturb the times
    code, printed, folder = accuracy("--resolution", "320x180")
    assert code == 0, printed.err
    rows = rows_of(folder)
    assert [row["asked"] for row in rows if row["unit"] == "px"][:7] == "16.0 8.0 4.0 2.0 1.0 0.5 0.25".split()
    assert {row["meshlet"] for row in rows} == {"0", "1", "2", "3", "4"}
    assert len(printed.out.splitlines()) == len(rows) + 1
    for row in rows:
        assert 0 < float(row["measured"]) <= float(row["bound"])
        geometric, *rounded = (float(row[f"bound_{part}"]) for part in TERMS)
        assert geometric + sum(rounded) == pytest.approx(float(row["bound"]))
        assert geometric > max(rounded) >= min(rounded) > 0
        assert (row["ms_fit"] == "") == (row["fitted"] == "False")
        assert float(row["ms_total"]) > 0 and int(row["triangles"]) > 1
        assert row["terrain"] == "hills" and row["popping_px_max"] == ""
        assert (row["screen_px_p95"] == "") == (row["unit"] == "m")
    content = json.loads((folder / "accuracy.json").read_text())
    terrain = content["terrains"][0]
    assert [str(r["triangles"]) for r in terrain["rows"]] == [row["triangles"] for row in rows]
    curves = [CostCurve.from_json(json.dumps(curve)) for curve in terrain["curves"]]
    assert [curve.unit for curve in curves] == ["px", "m"] and terrain["current"] == "1 px"
    assert {"Processor", "Python", "Warp", "numpy"} <= set(content["machine"])
    assert not list(folder.glob(".partial*"))


def test_the_page_needs_nothing_else_and_has_every_row(measured, accuracy):
    code, printed, folder = accuracy("--resolution", "160x90")
    assert code == 0, printed.err
    page = (folder / "index.html").read_text()
    assert re.findall(r'(?:src|href)="(?!data:image/png;base64,)', page) == []
    assert "<script" not in page and "@import" not in page
    assert set(re.findall(r"https?://[^\"' ]+", page)) == {"http://www.w3.org/2000/svg"}
    text = (folder / "accuracy.md").read_text()
    for row in known_rows():
        name = accuracy_plots.setting_label(row.setting)
        assert f"<td>{name}" in page and f"| {name}" in text
    assert "1 px (current)" in page and "1 px (current)" in text
    for printed in (page, text):
        assert "Halving the error from 1 px to 0.5 px costs 7.5 ms of CPU and 4,800 triangles" in printed
        assert "doubling it to 2 px saves 3 ms of CPU and 1,200 triangles. Part of" in printed
    plots = sorted(path.name for path in folder.glob("*.svg"))
    assert plots == [f"hills_{unit}_{cost}.svg" for unit in ("m", "px") for cost in ("ms", "triangles")]
    for name in plots:
        assert f"({name})" in text
        ElementTree.parse(folder / name)
    columns = [{line.count("|") for line in table.splitlines()} for table in text.split("\n\n") if table[0] == "|"]
    assert "<dt>Pareto front</dt>" in page and not re.findall(r"\*[A-Za-z ]+\*", page)
    assert len(columns) == 6 and all(len(counts) == 1 for counts in columns)
    assert page.startswith("<!doctype html>") and "<h1>hills.npy</h1>" in page and text.startswith("# hills.npy\n")


@needs_chromium
def test_a_browser_shows_the_page_with_every_picture(measured, accuracy, tmp_path):
    code, printed, folder = accuracy("--resolution", "320x180")
    assert code == 0, printed.err
    seen = opened(folder / "index.html", tmp_path / "chromium")
    assert not seen.errors and seen.wide <= 0
    assert len(seen.pictures) == 3 + 4 and all(there for _, there in seen.pictures)
    order = ["hills.npy", "largest error that was measured", "Halving", "Every row", "What the words mean"]
    assert [seen.text.index(words) for words in order] == sorted(seen.text.index(words) for words in order)


def test_the_strip_shows_the_same_part_at_four_errors(measured, accuracy):
    code, printed, folder = accuracy("--resolution", "320x180")
    assert code == 0, printed.err
    text = (folder / "accuracy.md").read_text()
    shown = [np.asarray(Image.open(folder / f"hills_{px}px.png")).astype(int) for px in (4, 2, 1)]
    assert sorted(path.name for path in folder.glob("*.png")) == ["hills_1px.png", "hills_2px.png", "hills_4px.png"]
    assert "| ![4 px](hills_4px.png) | ![2 px](hills_2px.png) | ![1 px](hills_1px.png) |" in text
    assert "**2 px**<br>" in text and " triangles, 2 ms a frame" in text, "what the row of that error has cost"
    coarse, middle, fine = shown
    assert coarse.shape == (180, 180, 3)
    right = np.add.outer(np.arange(180)[::-1], np.arange(180)) > 185  # no edges are drawn there
    apart = [np.abs(picture - fine)[right].mean() for picture in (coarse, middle)]
    assert apart[0] > apart[1] > 0


def test_a_path_is_measured_at_its_frames_and_between_them(few, accuracy, flight):
    code, printed, folder = accuracy("--path", flight, "--frames", "2-6:2", "--resolution", "96x54")
    assert code == 0, printed.err
    on_screen = [row for row in rows_of(folder) if row["unit"] == "px"]
    assert all(float(row["popping_px_max"]) > 0 for row in on_screen)
    content = json.loads((folder / "accuracy.json").read_text())["terrains"][0]
    assert content["frames"] == [2, 4, 6] and content["seen"] == "along flight.json, 96 x 54 pixels"


def test_frames_of_a_path_are_spread_over_it(hills, flight):
    subject = accuracy_subject.store_subject(hills, flight, None, (320, 180))
    assert subject.frame_numbers == [1, 4, 6, 9]
    assert [frame.after is None for frame in subject.frames] == [False] * 3 + [True]
    assert accuracy_subject.spread_frames(3, 3) == [3]
    assert len(accuracy_subject.spread_frames(1, 1000)) == accuracy_subject.SPREAD


@pytest.mark.parametrize("resolution", [(1920, 1080), (200, 900), (500, 500)])
def test_the_overview_has_the_whole_terrain_in_the_picture(hills, resolution):
    heights = open_store(hills)
    view = accuracy_subject.whole_view(heights, resolution)
    corners = np.array([(x, y, z, 1) for x in (-160, 160) for y in (-160, 160) for z in (-30, 30)])
    clip = corners @ (view.projection @ view.world_to_camera).T
    assert np.abs(clip[:, :2] / clip[:, 3:]).max() < 1
    assert np.abs(clip[:, :2] / clip[:, 3:]).max() > 0.5


def test_the_terrains_of_a_scene_with_the_settings_of_its_render(few, scene, add_terrain, accuracy, tmp_path):
    import bpy

    add_terrain("Near")
    far = add_terrain("Far")
    far.location.y = 1500
    far.adaptive_terrain.render.error_px, far.adaptive_terrain.render.meshlet = 3.0, 2
    scene.render.resolution_x, scene.render.resolution_y = 96, 54
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    code, printed, folder = accuracy("--frames", "1-2", source=("--scene", tmp_path / "scene.blend"))
    assert code == 0, printed.err
    rows = rows_of(folder)
    assert [row["terrain"] for row in rows] == ["Far"] * 5 + ["Near"] * 4
    assert (rows[0]["asked"], rows[0]["meshlet"]) == ("3.0", "2")
    assert all(float(row["ms_ingest"]) > 0 for row in rows if row["fitted"] == "False")
    assert {row["popping_px_max"] for row in rows if row["unit"] == "px"} == {"0.0"}  # the camera stands
    terrains = json.loads((folder / "accuracy.json").read_text())["terrains"]
    assert [terrain["current"] for terrain in terrains] == ["3 px, meshlet 2", "1 px"]
    assert terrains[0]["seen"] == "through the camera of scene.blend, 96 x 54 pixels"


def asking(criterion: Criterion, interpolation: str = "bilinear") -> SimpleNamespace:
    return SimpleNamespace(criterion=criterion, interpolation=interpolation)


def test_a_sweep_reports_omitted_settings():
    plain = Criterion(error_px=2.0, meshlet=1)
    assert accuracy_subject.setting_of_request(asking(plain)) == Setting("px", 2.0, meshlet=1)
    smooth = Setting("px", 2.0, meshlet=1, interpolation="bicubic")
    assert accuracy_subject.setting_of_request(asking(plain, "bicubic")) == smooth
    assert accuracy_subject.omission_notes(plain) == []
    metres = Criterion(error_px=0, error_m=0.5, max_triangles=1000, max_depth=9)
    assert accuracy_subject.setting_of_request(asking(metres)) == Setting("m", 0.5, max_depth=9)
    [note] = accuracy_subject.omission_notes(metres)
    assert "limits of triangles" in note
    edges = Criterion(error_px=0, edge_px=4)
    assert (
        accuracy_subject.setting_of_request(asking(edges)) is None and len(accuracy_subject.omission_notes(edges)) == 2
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--store", "x", "--scene", "y"], "not allowed with argument"),
        ([], "one of the arguments --scene --store is required"),
        (["--scene", "x.blend", "--path", "y.json"], "--path belongs to --store"),
        (["--store", "x", "--camera", "Camera"], "--camera belongs to --scene"),
        (["--store", "x", "--frames", "1-3"], "--frames are those of a --path"),
        (["--store", "x", "--path", "y.json", "--frames", "3-1"], "go backwards"),
        (["--store", "x", "--resolution", "0x10"], "not two numbers above 0"),
    ],
)
def test_arguments_that_contradict_each_other_are_wrong_usage(accuracy, arguments, message):
    code, printed, folder = accuracy(source=arguments)
    assert code == 2 and message in printed.err
    assert not folder.exists()


def test_input_that_cannot_be_used_is_one_sentence(accuracy, hills, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "taken" / "index.html").mkdir(parents=True)
    for arguments, message in (
        ({"source": ("--store", tmp_path / "none")}, "There is no terrain store at"),
        ({"source": ("--store", hills, "--path", tmp_path / "none.json")}, "cannot be read"),
        ({"out": "file"}, "expected a folder"),
        ({"out": "file/inside"}, "expected a folder"),
        ({"out": "taken"}, "index.html is a folder"),
        ({"source": ("--scene", tmp_path / "none.blend")}, "There is no scene at"),
    ):
        code, printed, _ = accuracy(**arguments)
        assert code == 1 and message in printed.err, printed.err
        assert len(printed.err.splitlines()) == 1 and printed.out == ""


def test_an_unknown_camera_and_a_scene_without_one(scene, add_terrain, accuracy, tmp_path):
    import bpy

    add_terrain()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    code, printed, _ = accuracy("--camera", "Nobody", source=("--scene", tmp_path / "scene.blend"))
    assert code == 1 and "has no camera 'Nobody'; it has Camera" in printed.err
    bpy.context.scene.camera = None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "blind.blend"))
    code, printed, _ = accuracy(source=("--scene", tmp_path / "blind.blend"))
    assert code == 1 and "has no camera to refine for" in printed.err


def test_an_interruption_leaves_the_last_report_as_it_was(measured, accuracy, monkeypatch):
    assert accuracy("--resolution", "96x54")[0] == 0

    def interrupted(*arguments, **callbacks):
        callbacks["on_progress"](0.3)
        raise KeyboardInterrupt

    monkeypatch.setattr(accuracy_command, "sweep", interrupted)
    code, printed, folder = accuracy("--progress")
    before = {path.name for path in folder.iterdir()}
    assert code == 130 and printed.err.endswith("adaptive-terrain: stopped\n") and " 30%" in printed.err
    assert len(rows_of(folder)) == len(known_rows())
    assert {"index.html", "accuracy.md", "accuracy.json"} <= before and not any(n.startswith(".") for n in before)


def test_a_bound_that_does_not_hold_is_a_failure(accuracy, monkeypatch):
    first, *rest = known_rows()
    too_proud = [dataclasses.replace(first, bound=2.5), *rest]
    monkeypatch.setattr(accuracy_command, "sweep", lambda *arguments, **options: too_proud)
    code, printed, folder = accuracy("--resolution", "96x54")
    assert code == 1 and "in 1 row, first of hills at 4 px: bounded by 2.5 px, measured 3:" in printed.err
    assert len(rows_of(folder)) == len(too_proud)


def test_files_of_a_report_are_replaced_together_or_not_at_all(tmp_path, monkeypatch):
    texts = {"a.svg": "new", "b.csv": "new", "c.html": "new"}
    for name in texts:
        (tmp_path / name).write_text("old")
    write = Path.write_bytes

    def full(path, content):
        if path.name.endswith("b.csv"):
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(TerrainError, match="b.csv cannot be written .No space left on device"):
        write_files(tmp_path, texts)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(texts, "old")
    monkeypatch.setattr(Path, "write_bytes", write)
    write_files(tmp_path, texts)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == texts
