# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows measured at small sizes."""

import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from adaptive_terrain.benchmarks import suite
from adaptive_terrain.benchmarks.pages import goals
from adaptive_terrain.benchmarks.rig import baselines, measure, scenes
from adaptive_terrain.benchmarks.rows import (
    demand_row,
    effects_row,
    engine,
    files,
    fit_row,
    in_blender,
    land_rows,
    maps_row,
    query_row,
    same_picture,
    scatter_row,
    split_merge_row,
    start,
)
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.operators.cli import command_line

SAMPLES = 129


@pytest.fixture(scope="module")
def flat():
    return from_array(np.zeros((SAMPLES, SAMPLES), np.float32), scenes.SIDE / (SAMPLES - 1))


@pytest.fixture(scope="module")
def rough():
    return from_array(scenes.noise(SAMPLES), scenes.SIDE / (SAMPLES - 1))


def test_a_search_finds_a_number_of_triangles(flat, rough):
    for flight, size in ((engine.edge_flight(flat, 5_000), 5_000), (engine.error_flight(rough, 8_000), 8_000)):
        flight()
        assert abs(flight.update.triangles - size) <= 0.01 * size
        first = flight.update.surface.positions.copy()
        assert set(flight()) >= {"refine", "weld", "displace", "total"}
        assert not np.array_equal(first, flight.update.surface.positions)


def test_an_impossible_size_is_one_sentence(rough):
    with pytest.raises(TerrainError, match=r"No refinement of about 1 triangles was found \(the last had 2\)"):
        engine.error_flight(rough, 1)


def test_a_still_camera_has_its_row(rough, monkeypatch):
    monkeypatch.setattr(engine, "MILLION", 5_000)
    row = engine.still_row(rough, None)
    assert row.ms > 0 and row.ratio is None and (row.name, row.size) == ("still", 5_000)


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_the_serial_baseline_rebuilds_on_request(tmp_path, flat):
    notes = []
    roam = baselines.build_roam_rebuild(tmp_path, notes.append)
    assert notes == []
    rebuild = roam.timer(2_000)
    assert all(rebuild() > 0 for _ in range(3))
    row = engine.refine_row("refine_1t", flat, 2_000, roam)
    assert row.ratio == row.ms / row.baseline_ms > 0
    assert row.steps["refine"] + row.steps["tree"] == row.ms and not {"weld", "displace", "total"} & set(row.steps)
    roam.close()


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_a_killed_baseline_is_one_sentence(tmp_path):
    roam = baselines.build_roam_rebuild(tmp_path, pytest.fail)
    rebuild = roam.timer(2_000)
    [process] = roam._running.values()
    process.kill()
    with pytest.raises(TerrainError, match="The process of roam_rebuild ended with code -9: run it again."):
        rebuild()
    roam.close()


def test_a_full_disk_is_reported_before_measuring(monkeypatch, capsys):
    monkeypatch.setattr(suite, "build_roam_rebuild", lambda *_: pytest.fail("it has begun"))
    monkeypatch.setattr(files, "STORE_BYTES", 1 << 40)
    assert command_line.main(["bench", "--quick"]) == 1
    output = capsys.readouterr().err
    assert "A benchmark needs 18455752372.5 GB in " in output and "let TMPDIR name a folder with more room." in output


def test_the_baseline_needs_a_compiler(tmp_path, flat, monkeypatch):
    monkeypatch.setattr(baselines.shutil, "which", lambda name: None)
    notes = []
    assert baselines.build_roam_rebuild(tmp_path, notes.append) is None
    assert notes == ["There is no C compiler here: the baseline roam_rebuild is left out."]
    row = engine.refine_row("refine_1t", flat, 2_000, None)
    assert row.ms > 0 and row.ratio is None


def test_a_compiler_that_fails_leaves_the_baseline_out(tmp_path, monkeypatch):
    monkeypatch.setattr(baselines, "SOURCE", tmp_path / "missing.c")
    notes = []
    if shutil.which("cc"):
        assert baselines.build_roam_rebuild(tmp_path, notes.append) is None
        assert "cannot build missing.c" in notes[0]


def test_a_written_store_holds_the_same_field(rough, tmp_path):
    stored = open_store(in_blender.write_store(rough, tmp_path / "store"))
    assert stored.key == rough.key and np.array_equal(stored.error, rough.error)


@pytest.mark.thorough
def test_cold_start_and_import_run_in_child_processes(rough, tmp_path, monkeypatch):
    monkeypatch.setattr(start, "RUNS", 1)
    monkeypatch.setattr(start, "SIZE", 2_000)
    store = in_blender.write_store(rough, tmp_path / "store")
    row = start.cold_start_row(rough, store)
    assert row.ms > row.figures["first_update_ms"] > 0
    monkeypatch.setattr(files, "IMPORT_RUNS", 1)
    tiff = files.write_tiff(rough, tmp_path / "rough.tif")
    imported = files.import_row(tiff, tmp_path)
    assert imported.figures["mb_per_s"] > 0 and imported.ratio == imported.ms / 5000
    assert np.array_equal(open_store(tmp_path / "imported").samples, rough.samples)
    monkeypatch.setattr(files, "MOSAIC_SIDE", 3)
    monkeypatch.setattr(files, "MOSAIC_RUNS", 1)
    mosaic = files.mosaic_row(rough, tiff, tmp_path)
    assert mosaic.ratio > 0 and len(list((tmp_path / "tiles").iterdir())) == 9


@pytest.mark.thorough
def test_a_large_raster_is_imported_and_removed(rough, tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "SAMPLES", SAMPLES)
    monkeypatch.setattr(files, "LARGE_SAMPLES", 4 * (SAMPLES - 1) + 1)
    monkeypatch.setattr(files, "MILLION", 12_000)
    small = files.write_tiff(rough, tmp_path / "rough.tif")
    stored, store_of = [], files._large_frames
    monkeypatch.setattr(
        files, "_large_frames", lambda *stores: [stored.extend(map(open_store, stores)), *store_of(*stores)][1:]
    )
    rows = list(files.large_rows(small, tmp_path, pytest.fail))
    assert [row.name for row in rows] == ["import_large", "large_frame", "large_memory"]
    assert all(row.ratio > 0 for row in rows) and rows[0].size == (4 * (SAMPLES - 1) + 1) ** 2
    large, same = stored
    assert np.array_equal(same.samples, rough.samples)
    assert np.array_equal(large.samples[:128, :128], large.samples[384:512, 128:256]) and large.samples.std() > 10
    assert [path.name for path in tmp_path.iterdir()] == ["rough.tif"]
    notes = []
    monkeypatch.setattr(files, "STORE_BYTES", 1 << 60)
    assert list(files.large_rows(small, tmp_path, notes.append)) == [] and len(notes) == 1


def test_a_frame_in_blender(rough, tmp_path):
    bpy = pytest.importorskip("bpy")
    from adaptive_terrain.operators.blender import need_bpy

    need_bpy("A test")
    store = in_blender.write_store(rough, tmp_path / "store")
    next_frame, plain = in_blender.frames(rough, store, 5_000)
    ours = bpy.data.objects["Terrain"].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert plain() > 0
    plain_mesh = bpy.data.meshes["Plain"]
    counts = [(len(mesh.vertices), len(mesh.edges), len(mesh.polygons)) for mesh in (ours, plain_mesh)]
    assert counts[0] == counts[1] and len(plain_mesh.uv_layers) == 1 and not plain_mesh.validate()
    steps = next_frame()
    assert steps["total"] >= steps["refine"] + steps["mesh"] > 0
    assert bpy.context.scene.frame_current == 1


@pytest.fixture
def small_suite(monkeypatch):
    """Make every size so small that a quick run takes seconds."""
    for module, sizes in {
        scenes: {"SAMPLES": SAMPLES, "STEP": 0.01, "MILLION": 8_000},
        engine: {"REFINE_SIZES": {"refine_1t": (1, (2_000,)), "refine_2t": (2, (2_000,))}, "BUDGET_SIZE": 2_000},
        in_blender: {"FRAME_SIZES": (8_000, 16_000)},
        measure: {"BLOCKS": 1, "SHORT_BLOCKS": 1, "RUNS": 2},
        land_rows: {"SAMPLES": SAMPLES, "WATER_SAMPLES": SAMPLES, "MARCHED_S": 1.0},
        scatter_row: {"SCATTER": replace(scatter_row.SCATTER, spacing=20.0)},
        maps_row: {"SAMPLES": 129, "TEXELS": 128},
        query_row: {"POINTS": 2_500},
        split_merge_row: {"SIZE": 2_000},
        start: {"SIZE": 2_000, "RUNS": 1},
    }.items():
        for name, value in sizes.items():
            monkeypatch.setattr(module, name, value)
    for module in (engine, effects_row, demand_row):
        monkeypatch.setattr(module, "MILLION", 8_000)


ENGINE_ROWS = ["refine_1t", "refine_2t", "refine_error", "still", "surface", "split_merge", "budget_flight"]
ENGINE_ROWS += ["morph_flight", "hidden", "effects_flight", "light_preview", "land_rivers", "land_scree", "land_water"]
ENGINE_ROWS += ["scatter_flight", "maps_normal", "query_heights"]


@pytest.mark.thorough
def test_a_quick_run_has_every_row_that_takes_seconds(small_suite, tmp_path):
    pytest.importorskip("bpy")
    notes = []
    rows = suite.measure_rows(suite.list_measures(tmp_path, True, False, None, None, notes.append), attempts=1)
    assert [row.name for row in rows] == [*ENGINE_ROWS, "demand", "frame"]
    assert all(row.ms > 0 for row in rows) and {row.name for row in rows} <= set(goals.ROWS)
    assert notes[-1] == "The rows same_picture are measured with --with-cycles only."


def test_a_whole_run_measures_every_row(small_suite, tmp_path):
    pytest.importorskip("bpy")
    measures = [*suite.list_measures(tmp_path, False, True, ["blender"], None, pytest.fail)]
    quick = [*suite.list_measures(tmp_path / "quick", True, False, None, None, print)]
    functions = {m.func if isinstance(m, partial) else m for m in measures}
    only_whole = functions - {m.func if isinstance(m, partial) else m for m in quick}
    rows = {
        fit_row.fit_rows: ["fit_jacksboro"],
        start.cold_start_row: ["cold_start"],
        files.import_row: ["import"],
        files.mosaic_row: ["import_mosaic"],
        files.large_rows: ["import_large", "large_frame", "large_memory"],
        suite.in_program.program_frame_row: ["program_frame"],
        same_picture.same_picture_rows: ["same_picture", "same_picture_memory"],
    }
    assert only_whole == set(rows)
    assert {*ENGINE_ROWS, "demand", "frame", *(name for names in rows.values() for name in names)} == set(goals.ROWS)


def test_rows_that_need_blender_are_omitted_without_it(small_suite, tmp_path, monkeypatch):
    def no_blender(what):
        raise TerrainError(f"There is no Blender. {what}")

    monkeypatch.setattr(suite, "need_bpy", no_blender)
    notes = []
    measures = list(suite.list_measures(tmp_path, True, False, None, None, notes.append))
    functions = {getattr(measure, "func", measure) for measure in measures}
    assert query_row.query_heights_row in functions
    assert not functions & {demand_row.demand_row, in_blender.frame_row}
    assert "There is no Blender. The rows demand, frame and same_picture." in notes and len(notes) == 3


def test_a_scatter_with_wrong_points_is_refused():
    ids = np.arange(1000)
    scatter_row.check_points(ids, ids)
    scatter_row.check_points(ids[5:], ids)
    for wrong in (ids + 1, ids[20:], np.append(ids, 2000)):
        with pytest.raises(TerrainError, match="other points than the same in numpy"):
            scatter_row.check_points(wrong, ids)


def test_a_fit_is_compared_with_greedy_insertion(rough):
    class Greedy:
        """Stand-in for pydelatin's Delatin."""

        def __init__(self, heights, max_error):
            assert heights.shape == rough.samples.shape and max_error == 2.0
            self.triangles = np.zeros((1000, 3))

    row = fit_row.fit_row("fit_rough", rough, 2.0, Greedy)
    figures = row.figures
    assert row.size < figures["plain_triangles"] and 0 < figures["bound_m"] <= figures["error_m"] == 2.0
    assert row.ratio == row.size / 1000 and figures["greedy_triangles"] == 1000 and figures["greedy_ms"] > 0
    alone = fit_row.fit_row("fit_rough", rough, 2.0)
    assert alone.size == row.size and alone.ratio is None and "greedy_triangles" not in alone.figures


def test_the_real_terrain_of_the_fit_has_the_stated_size():
    heights = fit_row.jacksboro()
    assert heights.shape == (321, 385)
    assert 200 < heights.min() < 300 and 1000 < heights.max() < 1100
