# SPDX-License-Identifier: GPL-3.0-or-later
"""The sweep: its settings, its rows, and that its times are of updates that reuse nothing."""

import dataclasses
import functools
import itertools
import time

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import Measurement, measure
from adaptive_terrain.cbt_terrain.accuracy.mesh import Errors
from adaptive_terrain.cbt_terrain.accuracy.rows import Row, curve_of, median_count, pareto, unsteady_row, worst
from adaptive_terrain.cbt_terrain.accuracy.sweep import sweep
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import PIXELS, Setting, metre_steps, settings_for
from adaptive_terrain.cbt_terrain.accuracy.timed_runs import (
    RUNS,
    SHORT_UPDATES,
    TimedFrame,
    fastest_run,
    median_by_step,
    timed_runs,
)
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from finer_fields import finer_field

SEEN = View.look((0, -700, 500), (0, 0, 0), resolution=(640, 360))
FURTHER = View.look((300, -1400, 700), (0, 0, 0), resolution=(640, 360))


@pytest.fixture(autouse=True)
def few_points(monkeypatch):
    """Measure fewer random points; those of the mesh and of the raster are all measured."""
    path = "adaptive_terrain.cbt_terrain.accuracy.sweep.measure"
    monkeypatch.setattr(path, functools.partial(measure, random_points=5000))


@pytest.fixture(scope="module")
def field():
    return rough(65, 65)


def errors(largest: float) -> Errors:
    return Errors(10, largest, 0.8 * largest, largest, 0.3 * largest, 0.4 * largest)


def make_row(setting: Setting, error: float, triangles: int, ms: float, limited: str = "", ingest: float = 0.0) -> Row:
    pixels = errors(error) if setting.unit == "px" else None
    measured = Measurement(errors(error), error, 1e-6, errors(9.0), errors(2.0), pixels, pixels, pixels)
    times = {"total": ms, "refine": 0.5 * ms} | ({"ingest": ingest} if ingest else {})
    return Row(
        setting, setting.error, (limited,) if limited else (), triangles, triangles // 2, 1.0, 2.0, measured, ms=times
    )


def test_no_other_point_is_as_good_in_both_and_better_in_one():
    points = [(4.0, 1.0), (2.0, 2.0), (2.0, 3.0), (3.0, 2.5), (1.0, 4.0), (1.0, 4.0), (0.5, 9.0), (5.0, 1.0)]
    assert pareto(points) == [0, 1, 4, 6]
    assert pareto([]) == [] and pareto([(1.0, 1.0)]) == [0]
    rng = np.random.default_rng(3)
    many = [tuple(p) for p in rng.integers(0, 9, (60, 2)).astype(float)]
    beaten = [any(b[0] <= a[0] and b[1] <= a[1] and b != a for b in many) for a in many]
    assert {many[i] for i in pareto(many)} == {p for p, lost in zip(many, beaten, strict=True) if not lost}


def test_steps_in_metres_are_powers_of_two():
    assert metre_steps(1638.0) == [32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 0.5]
    assert metre_steps(0.02)[0] == 2.0**-11 <= 0.02 / 32
    assert metre_steps(0.0)[0] == 1.0


def test_a_sweep_with_a_camera_varies_every_kind_of_setting(field):
    settings = settings_for(field, TimedFrame([SEEN]))
    own, other = ([s for s in settings if s.interpolation == name] for name in ("bilinear", "bicubic"))
    assert [s.error for s in own if s.unit == "px" and s.is_plain] == list(PIXELS)
    assert [s.error for s in other if s.unit == "px"] == list(PIXELS[::2]) and all(s.is_plain for s in other)
    assert [s.max_depth for s in settings if s.max_depth] == [7, 9, 11, 13]  # cells are split at depth 13
    assert [s.meshlet for s in settings if s.meshlet] == [1, 2, 3, 4]
    metres = [s for s in own if s.unit == "m"]
    assert [s.error for s in metres if s.is_plain] == metre_steps(field.max_height - field.min_height)
    assert [s for s in settings_for(field, TimedFrame()) if s.unit == "px"] == []
    scaled = settings_for(field, TimedFrame(vertical_scale=-2.0))
    assert scaled[0].error == 2 * metres[0].error


def test_a_sweep_of_a_smooth_surface_includes_the_bilinear_one(field):
    settings = settings_for(interpolated(field, "bicubic"), TimedFrame([SEEN]))
    smooth, flat = ([s for s in settings if s.interpolation == name] for name in ("bicubic", "bilinear"))
    assert [s.error for s in smooth if s.unit == "px" and s.is_plain] == list(PIXELS)
    assert all(s.is_plain or s.fitted for s in flat) and not any(s.fitted for s in smooth)


@pytest.mark.thorough
def test_a_sweep_of_finer_tiles_has_both_surfaces():
    field = finer_field(rows=33, columns=33, known=((0, 0),))
    settings = settings_for(field, TimedFrame([SEEN]))
    assert {s.interpolation for s in settings} == {"bilinear", "bicubic"} and any(s.fitted for s in settings)
    some = [s for s in settings if s.error == (PIXELS[0] if s.unit == "px" else 1.0)]
    assert {(s.unit, s.interpolation) for s in some if s.is_plain} == set(
        itertools.product(("px", "m"), ("bilinear", "bicubic"))
    )
    assert any(s.fitted for s in some)
    for row in sweep(field, some, [TimedFrame([SEEN])]):
        assert 0 < row.error <= row.bound * (1 + 1e-6)


def test_transitions_are_measured_with_and_without_geomorph(field):
    moving = TimedFrame([SEEN], after=TimedFrame([FURTHER]))
    for own, other in ((1.0, SMOOTH), (SMOOTH, 1.0), (2.5, 1.0)):
        changed = [s for s in settings_for(field, moving, own) if s.morph is not None]
        assert [s.error for s in changed] == [4.0, 2.0, 1.0, 0.5] and not any(s.is_plain for s in changed)
        assert {s.criterion(Criterion(morph=own)).morph for s in changed} == {other}
        assert Setting("px", 1.0).criterion(Criterion(morph=own)).morph == own
    assert not any(s.morph for s in settings_for(field, TimedFrame([SEEN])))


def test_a_setting_replaces_errors_but_not_off_screen_values():
    base = Criterion(error_px=3, edge_px=2, error_m=1, guard_deg=9, off_screen_factor=2, max_triangles=10, max_depth=5)
    asked = Setting("m", 0.5, meshlet=2).criterion(base)
    assert (asked.error_px, asked.edge_px, asked.error_m, asked.max_depth, asked.meshlet) == (0, 0, 0.5, None, 2)
    assert (asked.guard_deg, asked.off_screen_factor) == (9, 2)
    assert Setting("px", 0.5, max_depth=7).criterion(base).max_depth == 7


def test_a_row_holds_setting_bound_error_and_cost(field):
    settings = [Setting("px", 4.0), Setting("px", 1.0), Setting("px", 1.0, meshlet=2), Setting("m", 2.0)]
    settings += [Setting("px", 1.0, interpolation="bicubic"), Setting("m", 2.0, interpolation="bicubic")]
    told, progress = [], []
    rows = sweep(field, settings, [TimedFrame([SEEN])], on_row=told.append, on_progress=progress.append)
    assert rows == told and [row.setting for row in rows] == settings
    assert progress == sorted(progress) and progress[0] == 0 and progress[-1] == 1
    for row in rows:
        assert row.bound <= row.setting.error * (1 + 1e-6)
        assert 0 < row.error <= row.bound * (1 + 1e-6)
        assert {"refine", "weld", "displace", "total"} <= set(row.ms)
        assert sum(ms for step, ms in row.ms.items() if step != "total") <= 1.5 * row.ms["total"]
        assert row.surface_mb == pytest.approx((row.vertices * 32 + row.triangles * 28 + 8 * _edges(row)) / 1e6)
        assert row.buffers_mb > row.surface_mb
    assert rows[0].triangles < rows[1].triangles < rows[2].triangles
    assert "meshlets" in rows[2].ms and rows[2].triangles % 16 == 0
    assert rows[3].measured.screen_px is None
    assert rows[4].triangles > rows[1].triangles, "a smooth surface has more to follow"
    names = [list(row.figures()) for row in rows]
    assert all(other == names[0] for other in names)
    figures = rows[1].figures()
    assert figures["measured"] == figures["screen_px_max"] and figures["asked"] == 1


def _edges(row: Row) -> int:
    return row.vertices + row.triangles - 1  # Euler, of a disc


def test_several_frames_give_the_worst_error_and_popping(field):
    setting = Setting("px", 2.0)
    apart = [sweep(field, [setting], [TimedFrame([view])])[0] for view in (SEEN, FURTHER)]
    both = sweep(field, [setting], [TimedFrame([SEEN], after=TimedFrame([FURTHER])), TimedFrame([FURTHER])])[0]
    assert both.error == max(row.error for row in apart)
    assert both.bound == max(row.bound for row in apart)
    assert both.measured.screen_px.count == sum(row.measured.screen_px.count for row in apart)
    assert [row.popping_px for row in apart] == [None, None]
    assert 0 < both.popping_px.max and 0 < both.shading_change.max < 2 * 255
    assert both.figures()["shading_change_max"] == both.shading_change.max
    still = sweep(field, [setting], [TimedFrame([SEEN], after=TimedFrame([SEEN]))])[0]
    assert still.popping_px.max == still.shading_change.max == 0


def test_raising_ends_a_sweep(field):
    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop

    for callback in ("on_row", "on_progress"):
        with pytest.raises(Stop):
            sweep(field, [Setting("m", 4.0)], [TimedFrame()], **{callback: stop})


def test_writing_the_mesh_is_a_separate_step(field):
    written = []

    def write(surface):
        written.append(len(surface.level))
        return 7.0  # milliseconds

    row = sweep(field, [Setting("m", 4.0)], [TimedFrame()], write=write)[0]
    assert set(written) == {row.triangles} and len(written) in (RUNS + 1, RUNS * SHORT_UPDATES + 1)
    assert row.ms["ingest"] == 7.0 and row.whole_ms == row.ms["total"] + 7.0


@pytest.mark.parametrize("frame", [TimedFrame([SEEN]), TimedFrame(), TimedFrame([SEEN], vertical_offset=1e6)])
@pytest.mark.parametrize("relief", [0.0, 1.0])
def test_no_timed_run_finds_the_mesh_done_already(relief, frame):
    heights = from_array(np.outer(np.hanning(33), np.hanning(33)) * relief)
    criterion = Criterion(error_px=0 if not frame.views else 50, error_m=5)
    runs = timed_runs(Terrain(heights), criterion, frame, 3)
    assert len(runs) >= 3
    assert all({"refine", "weld", "displace", "total"} <= set(run) for run in runs)


def test_runs_are_compared_by_processor_time(field):
    runs = timed_runs(Terrain(field), Criterion(error_px=0, error_m=4.0), TimedFrame(), 4, write=lambda surface: 7.0)
    assert len(runs) == 4 and all(run["ingest"] == 7.0 and run["cpu"] > 0.0 for run in runs)
    assert fastest_run(runs)["cpu"] == min(run["cpu"] for run in runs)
    # A sleep takes elapsed time, and no time of a processor.
    slow = timed_runs(
        Terrain(field), Criterion(error_px=0, error_m=4.0), TimedFrame(), 2, write=lambda _: time.sleep(0.05) or 50.0
    )
    assert fastest_run(slow)["cpu"] < 30.0


def test_a_curve_needs_runs_that_agree():
    rows = [make_row(Setting("px", error), error, 100, 4.0 / error) for error in (4.0, 2.0, 1.0)]
    agreed = [dataclasses.replace(row, spread_ms=(1.0, 2.0)) for row in rows]
    assert unsteady_row(agreed) is None and unsteady_row(rows) is None and unsteady_row([]) is None
    torn = [*agreed[:2], dataclasses.replace(rows[2], spread_ms=(1.0, 2.1))]
    assert unsteady_row(torn) is torn[2]
    limited = dataclasses.replace(torn[2], limited=("max_triangles",))
    assert unsteady_row([*agreed[:2], limited]) is None, "it is no part of the curve"


@pytest.mark.parametrize("counts", [[3, 5], [5, 3], [4, 1, 9], [1, 2, 2, 7], [7]])
def test_the_median_of_two_counts_is_their_mean(counts):
    assert median_count(counts) == np.median(counts)
    assert isinstance(median_count([3, 5]), int)


def test_a_row_of_two_frames_has_the_mean_of_their_counts(field):
    frames = [TimedFrame([SEEN]), TimedFrame([View.look((0, -900, 900), (0, 0, 0))])]
    alone = [sweep(field, [Setting("px", 2.0)], [frame])[0] for frame in frames]
    both = sweep(field, [Setting("px", 2.0)], frames)[0]
    assert alone[0].triangles != alone[1].triangles
    assert both.triangles == sum(row.triangles for row in alone) / 2
    assert both.vertices == sum(row.vertices for row in alone) / 2


def test_the_median_counts_a_step_that_was_not_taken_as_nothing():
    assert median_by_step([{"a": 1.0}, {"a": 3.0, "b": 2.0}, {"b": 2.0}]) == {"a": 1.0, "b": 2.0}


def test_the_curve_goes_through_the_plain_rows_of_one_unit():
    rows = [
        make_row(Setting("px", 2.0), 1.5, 1000, 4.0, ingest=1.0),
        make_row(Setting("px", 1.0), 0.8, 3000, 9.0, ingest=1.0),
        make_row(Setting("px", 1.0, meshlet=2), 0.4, 9000, 7.0),
        make_row(Setting("px", 1.0, max_depth=9), 2.0, 500, 2.0, "max_depth"),
        make_row(Setting("px", 0.5), 0.9, 3100, 30.0, "max_triangles"),
        make_row(Setting("m", 1.0), 0.9, 70, 1.0),
        make_row(Setting("px", 4.0, interpolation="bicubic"), 3.0, 5, 0.5),
    ]
    curve = curve_of(rows)
    assert (curve.unit, curve.error, curve.triangles, curve.ms) == ("px", (2, 1), (1000, 3000), (5, 10))
    with pytest.raises(TerrainError, match="1 errors"):
        curve_of(rows[-1:])
    with pytest.raises(TerrainError, match="0 errors"):
        curve_of([])


def test_the_worst_of_several_has_the_largest_of_every_figure():
    parts = [make_row(Setting("px", 2.0), error, 10, 1.0).measured for error in (1.0, 3.0, 2.0)]
    found = worst([*parts, dataclasses.replace(parts[0], screen_px=None, rounding_m=5.0)])
    assert found.vertical_max_m == 3 and found.vertical_m.count == 40 and found.rounding_m == 5
    assert found.screen_px == dataclasses.replace(errors(3.0), count=30)
    assert worst([]) is None


def test_a_finer_error_never_costs_fewer_triangles(field):
    rows = sweep(field, [Setting("px", error) for error in PIXELS], [TimedFrame([SEEN])])
    assert all(a.triangles <= b.triangles for a, b in itertools.pairwise(rows))
    assert all(a <= b for a, b in itertools.pairwise(curve_of(rows).ms))


def test_effects_are_a_step_of_the_cost(field):
    """What is read is made once for every run, written with the mesh, and is part of the time to the finished mesh."""
    written = []

    def write(surface):
        written.append("slope" in surface.attributes)
        return 1.0

    asked = plan([AttributeRequest("slope", ("a test",))])
    [row] = sweep(field, [Setting("px", 4.0)], [TimedFrame([SEEN])], write=write, effects=asked)
    [bare] = sweep(field, [Setting("px", 4.0)], [TimedFrame([SEEN])], write=write)
    made = written.count(True)
    assert made > RUNS and written == [True] * made + [False] * (len(written) - made)
    assert row.ms["effects"] > 0 and row.whole_ms == row.ms["total"] + row.ms["effects"] + 1.0
    assert "effects" not in bare.ms and bare.figures()["ms_effects"] is None
