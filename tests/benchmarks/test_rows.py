# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows measured small: they time what they say, without a limit on how long it takes."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.benchmarks import suite
from adaptive_terrain.benchmarks.pages import goals
from adaptive_terrain.benchmarks.pages.report import MEANING
from adaptive_terrain.benchmarks.rig import baselines, measure, scenes
from adaptive_terrain.benchmarks.rows import (
    demand_rows,
    effects,
    engine,
    files,
    fit_row,
    in_blender,
    land_rows,
    layer_rows,
    light_rows,
    maps_rows,
    morph_rows,
    query_rows,
    scale,
    scatter_rows,
    scree_rows,
    shading_row,
    start,
    water_rows,
)
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.operators.cli import command_line

SAMPLES = 129


@pytest.fixture(scope="module")
def flat():
    return from_array(np.zeros((SAMPLES, SAMPLES), np.float32), scenes.SIDE / (SAMPLES - 1))


@pytest.fixture(scope="module")
def rough():
    return from_array(scenes.noise(SAMPLES), scenes.SIDE / (SAMPLES - 1))


def test_a_search_finds_the_triangles_asked_for(flat, rough):
    for flight, size in ((engine.edge_flight(flat, 5_000), 5_000), (engine.error_flight(rough, 8_000), 8_000)):
        flight()
        assert abs(flight.update.triangles - size) <= 0.01 * size
        first = flight.update.surface.positions.copy()
        assert set(flight()) >= {"refine", "weld", "displace", "total"}
        assert not np.array_equal(first, flight.update.surface.positions)


def test_a_size_that_cannot_be_had_is_one_sentence(rough):
    with pytest.raises(TerrainError, match="No refinement of about 1 triangles was found; the last had 2."):
        engine.error_flight(rough, 1)


def test_the_finest_leaves_just_reach_their_depth(flat):
    for depth in (12, 16):
        px = 6.0
        view = scenes.around(0, scenes.height_reaching(depth, px))
        level = Terrain(flat).update(scenes.edges(px, depth), [view]).surface.level
        assert level.max() == depth
        deeper = Terrain(flat).update(scenes.edges(px, depth + 2), [view]).surface.level
        assert deeper.max() == depth


def test_trees_of_four_depths_hold_the_same_leaves(flat, monkeypatch):
    monkeypatch.setattr(engine, "DEPTHS", (12, 14))
    monkeypatch.setattr(engine, "DEPTH_SIZE", 1_000)
    seen = []
    monkeypatch.setattr(engine, "_depths", lambda name, flights: seen.append(flights))
    engine.depth_row(flat)
    engine.depth_reached_row(flat)
    levels = [[], []]
    for found, flights in zip(levels, seen, strict=True):
        for flight in flights.values():
            flight()
            found.append(flight.update.surface.level)
    assert np.array_equal(*levels[0]) and levels[0][0].max() == 12
    assert [level.max() for level in levels[1]] == [12, 14]


def test_a_still_camera_has_its_row(rough, monkeypatch):
    monkeypatch.setattr(engine, "MILLION", 5_000)
    row = engine.still_row(rough, None)
    assert row.ms > 0 and row.ratio is None and (row.name, row.size) == ("still", 5_000)


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_the_serial_baseline_rebuilds_when_asked(tmp_path, flat):
    notes = []
    roam = baselines.build_roam_rebuild(tmp_path, notes.append)
    assert notes == []
    rebuild = roam.timer(2_000)
    assert all(rebuild() > 0 for _ in range(3))
    row = engine.refine_row(flat, 2_000, 1, roam)
    assert row.ratio == row.ms / row.baseline_ms > 0
    assert row.figures["whole_ms"] > 0
    roam.close()


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_a_baseline_that_was_killed_is_one_sentence(tmp_path):
    roam = baselines.build_roam_rebuild(tmp_path, pytest.fail)
    rebuild = roam.timer(2_000)
    [process] = roam._running.values()
    process.kill()
    with pytest.raises(TerrainError, match="The process of roam_rebuild has ended with code -9; run it again."):
        rebuild()
    roam.close()


def test_a_disk_that_is_too_small_is_said_first(monkeypatch, capsys):
    monkeypatch.setattr(suite, "build_roam_rebuild", lambda *_: pytest.fail("it has begun"))
    monkeypatch.setattr(files, "STORE_BYTES", 1 << 40)
    assert command_line.main(["bench", "--quick"]) == 1
    said = capsys.readouterr().err
    assert "A benchmark needs 18455752372.5 GB in " in said and "let TMPDIR name a folder with more room." in said


def test_without_a_compiler_the_baseline_is_left_out(tmp_path, flat, monkeypatch):
    monkeypatch.setattr(baselines.shutil, "which", lambda name: None)
    notes = []
    assert baselines.build_roam_rebuild(tmp_path, notes.append) is None
    assert notes == ["There is no C compiler here: the baseline roam_rebuild is left out."]
    row = engine.refine_row(flat, 2_000, 1, None)
    assert row.ms > 0 and row.ratio is None


def test_a_compiler_that_fails_leaves_the_baseline_out(tmp_path, monkeypatch):
    monkeypatch.setattr(baselines, "SOURCE", tmp_path / "missing.c")
    notes = []
    if shutil.which("cc"):
        assert baselines.build_roam_rebuild(tmp_path, notes.append) is None
        assert "cannot build missing.c" in notes[0]


def test_a_kept_field_is_the_same_store(rough, tmp_path):
    kept = open_store(in_blender.keep(rough, tmp_path / "store"))
    assert kept.key == rough.key and np.array_equal(kept.error, rough.error)


def test_a_cold_start_and_an_import_are_processes_of_their_own(rough, tmp_path, monkeypatch):
    monkeypatch.setattr(start, "RUNS", 1)
    monkeypatch.setattr(start, "SIZE", 2_000)
    store = in_blender.keep(rough, tmp_path / "store")
    row = start.warm_row(rough, store)
    assert row.ms > row.figures["first_update_ms"] > 0
    monkeypatch.setattr(files, "IMPORT_RUNS", 1)
    tiff = files.write_tiff(rough, tmp_path / "rough.tif")
    imported, reopened = files.import_rows(tiff, tmp_path)
    assert imported.figures["mb_per_s"] > 0 and reopened.baseline_ms == 50
    assert np.array_equal(open_store(tmp_path / "imported").samples, rough.samples)


def test_a_larger_store_is_generated_measured_and_removed(rough, tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "SAMPLES", SAMPLES)
    monkeypatch.setattr(files, "LARGE_SAMPLES", 4 * (SAMPLES - 1) + 1)
    monkeypatch.setattr(files, "LARGE_SIZES", (12_000,))
    small = in_blender.keep(rough, tmp_path / "small")
    rows = list(files.large_rows(small, tmp_path, pytest.fail))
    assert [row.name for row in rows][:2] == ["large_open", "large_frame"]
    assert not (tmp_path / "large").exists()
    notes = []
    monkeypatch.setattr(files, "STORE_BYTES", 1 << 60)
    assert list(files.large_rows(small, tmp_path, notes.append)) == [] and len(notes) == 1


def test_a_frame_in_blender(rough, tmp_path):
    bpy = pytest.importorskip("bpy")
    from adaptive_terrain.operators.blender import need_bpy

    need_bpy("A test")
    write, plain = in_blender.writers(rough, 5_000)
    assert write()["total"] > 0 and plain() > 0
    ours, plainly = bpy.data.meshes["Mine"], bpy.data.meshes["Plain"]
    counts = [(len(mesh.vertices), len(mesh.edges), len(mesh.polygons)) for mesh in (ours, plainly)]
    assert counts[0] == counts[1] and len(ours.uv_layers) == len(plainly.uv_layers) == 1
    assert not plainly.validate()
    store = in_blender.keep(rough, tmp_path / "store")
    next_frame, _ = in_blender.frames(rough, store, 5_000)
    steps = next_frame()
    assert steps["total"] >= steps["refine"] + steps["mesh"] > 0
    assert bpy.context.scene.frame_current == 1


@pytest.fixture
def small_suite(monkeypatch):
    """Every size so small that the whole quick run takes seconds."""
    for module, sizes in {
        scenes: {"SAMPLES": SAMPLES, "STEP": 0.01},
        engine: {"REFINE_SIZES": {1: (2_000,), 2: (2_000,)}, "MILLION": 8_000, "MESHLET": 1},
        in_blender: {"MILLION": 8_000, "FRAME_SIZES": (8_000, 16_000)},
        measure: {"BLOCKS": 1, "SHORT_BLOCKS": 1, "RUNS": 2},
        effects: {"MILLION": 8_000},
        layer_rows: {"VERTICES": 5_000, "ROUTED": 65},
        land_rows: {"SAMPLES": SAMPLES},
        water_rows: {"SAMPLES": SAMPLES, "PART": 1.0},
        scree_rows: {"SAMPLES": SAMPLES, "PER_KM2": 20.0},
        light_rows: {"RUNS": 2},
        scatter_rows: {"SCATTER": replace(scatter_rows.SCATTER, spacing=20.0)},
        morph_rows: {"TRIANGLES": 8_000},
        maps_rows: {"SAMPLES": 129, "TEXELS": 128},
        query_rows: {"PLACES": 2_500, "RAYS": (16, 9), "MARCHED": 20},
        demand_rows: {"MILLION": 8_000},
        start: {"SIZE": 2_000, "RUNS": 1},
        scale: {"QUICK_SIZES": (8_000, 16_000)},
    }.items():
        for name, value in sizes.items():
            monkeypatch.setattr(module, name, value)
    for name, value in {"DEPTHS": (12, 14), "DEPTH_SIZE": 1_000, "BUDGET_SIZE": 2_000}.items():
        monkeypatch.setattr(engine, name, value)


STACK_EFFECTS = ("rivers", "thermal", "relief", "snow", "water")
ENGINE_ROWS = ["refine_1t", "refine_2t", "refine_error", "still", "surface", "meshlets"]
ENGINE_ROWS += ["effects_fused", "effects_cut", "effects_flight", "depth"]
ENGINE_ROWS += ["budget_first", "budget_flight", "budget_level", "splats", "flow", "light_rays", "light_preview"]
ENGINE_ROWS += ["land_relief", "land_routing", "land_rivers", "land_sediment"]
ENGINE_ROWS += ["land_demanded", "land_scree", "land_droplets", "land_water", "land_snow"]
ENGINE_ROWS += ["scatter", "scatter_flight", "hidden", "morph_flight", "morph_cut", "maps_normal", "detail_from_air"]
ENGINE_ROWS += ["detail_from_ground", "detail_displace", "query_heights", "query_rays", "query_sight"]


def test_a_quick_run_has_every_row_that_takes_seconds(small_suite, tmp_path):
    pytest.importorskip("bpy")
    notes = []
    rows = suite.measured(suite.everything(tmp_path, True, False, None, None, notes.append), attempts=1)
    scales = ["scale_refine", "scale_surface", "scale_ingest", "scale_frame"]
    assert [row.name for row in rows] == [
        *ENGINE_ROWS,
        *("ingest", "frame"),
        *("demand", "demand_large", "demand_kept", "effects_ingest"),
        *scales,
    ]
    assert all(row.ms > 0 for row in rows) and {row.name for row in rows} <= set(MEANING)
    assert notes[-1] == "The rows cycles are measured with --with-cycles only."


def test_rows_without_a_goal_are_of_a_whole_run(small_suite, tmp_path):
    pytest.importorskip("bpy")
    from adaptive_terrain.operators.blender import need_bpy

    need_bpy("A test")
    rough, flat = scenes.rough(), scenes.flat()
    store = in_blender.keep(rough, tmp_path / "rough")
    rows = [
        engine.depth_reached_row(flat),
        start.warm_row(rough, store),
        in_blender.frame_row(rough, store, in_blender.MILLION, engine.MESHLET),
        in_blender.still_frame_row(rough, store),
    ]
    assert [row.name for row in rows] == ["depth_reached", "cold_start", "frame_meshlets", "still_frame"]
    assert all(row.ms > 0 and goals.goal_of(row.name, row.size) is None for row in rows)
    assert {row.name for row in rows} <= set(MEANING)


def test_the_demos_stack_is_measured_by_effect_and_level(monkeypatch):
    monkeypatch.setattr(land_rows, "STACK_SAMPLES", (257, 513))
    small, large = land_rows.stack_rows()
    assert (small.size, large.size) == (257 * 257, 513 * 513)
    assert set(small.steps) == {f"{name}_{step}m" for name in STACK_EFFECTS for step in ("32",)}
    assert set(large.steps) == {f"{name}_{step}m" for name in STACK_EFFECTS for step in ("32", "16")}
    assert sum(large.steps.values()) < large.ms and min(large.steps.values()) > 0


def test_shading_by_a_map_is_nearer_to_the_truth_than_by_vertices(monkeypatch, tmp_path):
    monkeypatch.setattr(shading_row, "SAMPLES", 257)
    monkeypatch.setattr(shading_row, "RESOLUTION", (160, 90))
    error, flicker = shading_row.shading_rows(tmp_path)
    assert (error.name, flicker.name) == ("shading_error", "shading_flicker")
    assert {error.name, flicker.name} <= set(MEANING) and error.size > 100 and error.ms > 0
    assert 0.5 < error.figures["of_255"] < error.figures["vertices_of_255"] < 60 and 0 < error.ratio < 1
    assert 0 < flicker.figures["of_255"] < 30


def test_without_blender_its_rows_are_left_out(small_suite, tmp_path, monkeypatch):
    def no_blender(what):
        raise TerrainError(f"There is no Blender. {what}")

    monkeypatch.setattr(suite, "need_bpy", no_blender)
    notes = []
    measures = list(suite.everything(tmp_path, True, False, None, None, notes.append))
    functions = [getattr(measure, "func", measure) for measure in measures]
    assert functions[-2:] == [scale.refine_row, scale.surface_row]
    of_blender = {name for name in dir(in_blender) if name.endswith("_row")} | {"demand_rows", "ingest_row"}
    assert functions and not {function.__name__ for function in functions} & of_blender
    assert "There is no Blender. The rows ingest, frame and cycles" in notes and len(notes) == 3


def test_the_fit_stands_beside_interpolation_and_greedy_insertion(rough):
    class Greedy:
        """As pydelatin's Delatin is called."""

        def __init__(self, heights, max_error):
            assert heights.shape == rough.samples.shape and max_error == 2.0
            self.triangles = np.zeros((1000, 3))

    row = fit_row.fit_row("fit_rough", rough, 2.0, Greedy)
    figures = row.figures
    assert row.size < figures["plain_triangles"] and 0 < figures["bound_m"] <= figures["asked_m"] == 2.0
    assert figures["triangles_to_plain"] == row.size / figures["plain_triangles"]
    assert figures["triangles_to_greedy"] == row.size / 1000
    assert row.ratio == row.ms / row.baseline_ms > 0
    alone = fit_row.fit_row("fit_rough", rough, 2.0)
    assert alone.size == row.size and alone.ratio is None and "greedy_triangles" not in alone.figures


def test_the_real_terrain_of_the_fit_is_what_its_row_says():
    heights = fit_row.jacksboro()
    assert heights.shape == (321, 385)
    assert 200 < heights.min() < 300 and 1000 < heights.max() < 1100
