# SPDX-License-Identifier: GPL-3.0-or-later
"""The fit: its bound against brute force, its triangles against interpolation, and its side effects."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField, anchored
from adaptive_terrain.cbt_terrain.fit import fitter as fitter_room
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.fit.fitter import Fitter
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.kernels.fitting import raising
from fields import mesh_heights, reference_heights, rough, scattered
from invariants import arrays, assert_invariants

SHAPES = {"square": (33, 33), "wide": (17, 65), "tall": (97, 33), "resampled": (38, 61), "cell": (2, 2)}
HARD = "spike", "cliff", "checkerboard", "noise", "saddle", "hill"


def raster(kind: str, shape: tuple[int, int] = (33, 33)) -> np.ndarray:
    """Return float32 [rows, columns] metres."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return {
        "spike": np.where((x == shape[1] // 3) & (y == shape[0] // 2 + 1), 1000.0, 0.0),
        "cliff": np.where(x > 0.4 * shape[1], 1e4, 0.0) + np.random.default_rng(3).standard_normal(shape),
        "checkerboard": (x + y) % 2 * 10.0,
        "noise": 50.0 * np.random.default_rng(4).standard_normal(shape),
        "saddle": 0.3 * (x - 11.0) * (y - 5.0),
        "hill": 90.0 * np.exp(-((x - 14) ** 2 + (y - 17) ** 2) / 120.0),
    }[kind].astype(np.float32)


def plain(field: HeightField, error_m: float, **asked):
    return Terrain(field).update(Criterion(error_px=0.0, error_m=error_m, **asked))


def measured(field: HeightField, surface, scale: float = 1.0, offset: float = 0.0) -> float:
    """Return the largest distance at every sample, at the middles of cells, and at random points, metres."""
    lattice = field.lattice
    j, i = np.mgrid[: 2 * lattice.height - 1, : 2 * lattice.width - 1] / 2
    x = (i - (lattice.width - 1) / 2) * lattice.step_x
    y = (j - (lattice.height - 1) / 2) * lattice.step_y
    plane = np.concatenate([np.stack([x.ravel(), y.ravel()], 1), scattered(field, 4000)])
    return float(np.abs(reference_heights(field, plane) * scale + offset - mesh_heights(surface, plane)).max())


def assert_holds(field: HeightField, fitted, error_m: float) -> None:
    """Check that the bound holds for the measured error, and that there are no more triangles than interpolation
    needs."""
    assert_invariants(fitted.surface, field.lattice)
    found = measured(field, fitted.surface)
    assert found <= fitted.bound_m * (1 + 1e-6) + 1e-9
    assert fitted.bound_m <= error_m or fitted.limited
    assert fitted.triangles <= plain(field, error_m).triangles


@pytest.mark.parametrize(
    ("shape", "error_m"),
    [
        *((shape, 3.0) for shape in SHAPES),
        ("cell", 0.3),
        ("square", 30.0),
        *(pytest.param(shape, 0.3, marks=pytest.mark.thorough) for shape in SHAPES if shape != "cell"),
        *(pytest.param(shape, 30.0, marks=pytest.mark.thorough) for shape in SHAPES if shape != "square"),
    ],
)
def test_the_bound_holds_on_rough_ground(shape, error_m):
    field = rough(*SHAPES[shape], seed=5)
    fitted = fit(field, error_m)
    assert_holds(field, fitted, error_m)
    if fitted.rounds and fitted.triangles > 2 * field.lattice.squares:
        assert measured(field, fitted.surface) >= 0.5 * fitted.worst_m, "the bound is not wasteful"


@pytest.mark.parametrize(
    ("kind", "error_m"),
    [
        *((kind, 4.0) for kind in HARD),
        ("hill", 0.1),
        *(pytest.param(kind, 1.0, marks=pytest.mark.thorough) for kind in HARD),
        *(pytest.param(kind, 0.1, marks=pytest.mark.thorough) for kind in HARD if kind != "hill"),
    ],
)
def test_the_bound_holds_on_hard_ground(kind, error_m):
    # a hundredth of what noise is off takes a thousand triangles a cell
    field = from_array(raster(kind, (17, 17) if kind == "noise" else (33, 33)), 2.0)
    fitted = fit(field, error_m)
    assert_holds(field, fitted, error_m)
    # Interpolation does not count what float32 heights add.
    assert fitted.bound_m <= max(error_m, plain(field, error_m).bound_m * (1 + 1e-5))


@pytest.mark.parametrize("kind", ["checkerboard", "noise", "saddle", "hill"])
def test_the_measured_maximum_is_exact(kind):
    """Against points so dense that the maximum of a parabola between two of them is nearly theirs."""
    field = from_array(raster(kind, (17, 17)))
    fitted = fit(field, 2.0)
    x = np.linspace(-8, 8, 16 * 16 + 1)
    plane = np.stack(np.meshgrid(x, x), -1).reshape(-1, 2)
    found = np.abs(reference_heights(field, plane) - mesh_heights(fitted.surface, plane)).max()
    assert 0.99 * fitted.worst_m <= found <= fitted.worst_m * (1 + 1e-9)


@pytest.mark.parametrize("heights", ["constant", "plane"])
def test_a_plane_has_two_triangles_a_root_square(heights):
    y, x = np.mgrid[:33, :65].astype(np.float32)
    field = from_array(np.full_like(x, -7.0) if heights == "constant" else 3 * x - 2 * y, 4.0)
    fitted = fit(field, 0.01)
    assert fitted.triangles == 2 * field.lattice.squares
    assert fitted.worst_m == 0.0 and fitted.bound_m < 1e-9


@pytest.mark.parametrize("error_m", [0.1, 1.0])
def test_smooth_ground_takes_little_more_than_half_the_triangles(error_m):
    """Along a bend a free line errs half as much as a chord, and triangles go with the inverse of the error."""
    y, x = np.mgrid[:257, :257]
    heights = 60 * np.sin(x / 60) * np.cos(y / 45) + 20 * np.sin(x / 17 + y / 30)
    field = from_array(heights.astype(np.float32), 1.0)
    fitted, base = fit(field, error_m), plain(field, error_m)
    assert fitted.bound_m <= error_m
    assert fitted.triangles <= 0.65 * base.triangles


@pytest.mark.parametrize("error_m", [1.0, pytest.param(5.0, marks=pytest.mark.thorough)])
def test_rough_ground_takes_clearly_fewer_triangles(error_m):
    field = rough(257, 257, seed=2)
    fitted, base = fit(field, error_m), plain(field, error_m)
    assert fitted.bound_m <= error_m
    assert fitted.triangles <= 0.8 * base.triangles


def test_threads_do_not_change_a_byte(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 125)
    field = rough(65, 129, seed=9)
    one = fit(field, 0.25, threads=1)
    for threads in (2, 7):
        other = fit(field, 0.25, threads=threads)
        assert arrays(other.surface) == arrays(one.surface)
        assert other.bound_m == one.bound_m
    assert one.triangles > 10 * launch.SLICE_ITEMS, "enough for every sweep to be cut"


def test_vertices_leave_the_surface_but_not_their_place():
    field = rough(65, 65)
    fitted = fit(field, 4.0)
    plane = fitted.surface.positions[:, :2].astype(np.float64)
    off = np.abs(fitted.surface.positions[:, 2] - reference_heights(field, plane))
    assert 0.5 < off.max() <= 4.0
    assert np.array_equal(np.unique(plane % 10.0), [0.0]), "multiples of the raster's cell"


@pytest.mark.parametrize(("scale", "offset"), [(3.0, 0.0), (0.01, 250.0), (-2.0, -1e4)])
def test_scale_and_offset_of_heights(scale, offset):
    field = rough(65, 65)
    error_m = 3.0 * abs(scale)
    fitted = fit(field, error_m, vertical_scale=scale, vertical_offset=offset)
    assert fitted.bound_m <= error_m
    assert measured(field, fitted.surface, scale, offset) <= fitted.bound_m * (1 + 1e-6)
    assert abs(fitted.triangles / fit(field, 3.0).triangles - 1) < 0.05


@pytest.mark.parametrize("budget", [0, 40, 300])
def test_a_budget_is_kept_and_never_worse_than_interpolation(budget):
    field = rough(65, 65, seed=7)
    fitted, base = fit(field, 0.5, max_triangles=budget), plain(field, 0.5, max_triangles=budget)
    assert fitted.triangles <= max(budget, 2 * field.lattice.squares)
    assert fitted.limited == "max_triangles" and fitted.relaxed > 1
    assert measured(field, fitted.surface) <= fitted.bound_m <= base.bound_m


@pytest.mark.parametrize("error_m", [0.1, 0.01, 0.003])
def test_a_budget_is_used_well_for_errors_out_of_reach(error_m):
    field = rough(33, 33)
    fitted, base = fit(field, error_m, max_triangles=200), plain(field, error_m, max_triangles=200)
    assert fitted.rounds > 0 and fitted.triangles <= 200
    assert measured(field, fitted.surface) <= fitted.bound_m < 0.9 * base.bound_m


@pytest.mark.parametrize("shape", [pytest.param((65, 150), marks=pytest.mark.thorough), (6, 100)])
def test_a_budget_counts_triangles_that_the_border_cut_adds(shape):
    field, error_m = rough(*shape), 1e-3
    least = plain(field, error_m, max_triangles=0).triangles
    for budget in (0, 150, 151, 777):
        fitted, base = fit(field, error_m, max_triangles=budget), plain(field, error_m, max_triangles=budget)
        assert len(fitted.surface.triangles) <= max(budget, least)
        assert fitted.bound_m <= base.bound_m * (1 + 1e-9) and fitted.limited == base.limited == "max_triangles"


def test_a_budget_that_only_the_fit_keeps_does_not_limit():
    field = rough(129, 129, seed=7)
    free = fit(field, 2.0)
    assert free.triangles < plain(field, 2.0).triangles
    fitted = fit(field, 2.0, max_triangles=free.triangles)
    assert (fitted.limited, fitted.relaxed) == ("", 1.0)
    assert arrays(fitted.surface) == arrays(free.surface)


def test_rounded_plane_coordinates_are_part_of_the_bound():
    """Steps that float32 cannot hold shift the planes sideways: on a slope that is a difference of height."""
    y, x = np.mgrid[:65, :65]
    field = from_array((40.0 * x + 3.0 * np.sin(y / 5.0)).astype(np.float32), 10.1)
    fitted = fit(field, 0.5)
    assert fitted.worst_m < fitted.bound_m <= 0.5
    assert measured(field, fitted.surface) <= fitted.bound_m


def test_rounding_at_the_border_cut_is_part_of_the_bound():
    """New vertices on the rim of a raster that does not fit its squares are rounded after distances are measured."""
    y, x = np.mgrid[:146, :50]
    field = from_array((5000.0 + 0.0644196262 * x + 0.0214732162 * y).astype(np.float32), 57.990065542440526)
    for error_m in (0.0306, 0.0612):
        fitted = fit(field, error_m, vertical_scale=-1.0)
        measured_m = measure(field, fitted.surface, vertical_scale=-1.0, random_points=2000).vertical_max_m
        assert 0.9 * fitted.bound_m < measured_m <= fitted.bound_m


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["noise", "hill", "cliff", "checkerboard"])
def test_the_bound_is_not_below_the_measured_error(kind):
    """No tolerance: offsets and steps of which float64 and float32 round off most, budgets that nothing can keep."""
    large, turned, level, huge = (1.0, 1e7), (-2.0, -1234.5), (1e-9, 1e7), (1e9, 0.0)
    for shape, step, placed in (
        ((9, 5), 0.1, (large, turned, level, huge)),
        ((2, 33), 14.2, (turned, level)),
        ((9, 9), 10.1, (large, huge)),
    ):
        field = from_array(raster(kind, shape), step)
        for scale, offset in placed:
            relief = (field.max_height - field.min_height) * abs(scale)
            for error_m, budget in ((1e-4 * relief, None), (0.1 * relief, None), (1e-3 * relief, 30)):
                heights = {"vertical_scale": scale, "vertical_offset": offset}
                fitted = fit(field, error_m, max_triangles=budget, **heights)
                assert measure(field, fitted.surface, random_points=500, **heights).vertical_max_m <= fitted.bound_m
                found = Terrain(field).update(
                    Criterion(error_px=0.0, error_m=error_m, max_triangles=budget), (), None, *heights.values()
                )
                assert fitted.bound_m <= max(error_m, found.bound_m)


def test_progress_goes_up_and_may_cancel():
    seen = []
    fit(rough(65, 65), 1.0, on_progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0

    def stop(_fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(rough(65, 65), 1.0, on_progress=stop)


@pytest.mark.parametrize("error_m", [0.0, -1.0, float("nan")])
def test_the_requested_error_must_be_a_distance(error_m):
    with pytest.raises(TerrainError):
        fit(rough(9, 9), error_m)


def test_raised_errors_fit_into_a_byte(monkeypatch):
    """A wrapped code would merge triangles that are too coarse, and climb through every ancestor."""
    make_codes, raised = Fitter._codes, []

    def keep_codes(fitter, error_m):
        made = make_codes(fitter, error_m)
        raised.append((fitter, made[0]))
        return made

    monkeypatch.setattr(Fitter, "_codes", keep_codes)
    y, x = np.mgrid[:9, :9]
    assert_holds(field := from_array((1e3 * (x * y % 3)).astype(np.float32)), fit(field, 6.0), 6.0)
    halvings = max((fitter.depth - field.lattice.cell_depth) // 2 for fitter, _ in raised)
    assert halvings == 4 <= raising.MAX_HALVINGS and max(codes.max() for _, codes in raised) <= 193
    assert raising.RAISED + raising.MAX_HALVINGS * 2 * raising.PER_OCTAVE == 225
    monkeypatch.setattr(fitter_room, "usual_depth", lambda field: field.lattice.cell_depth + 12)
    with pytest.raises(AssertionError):
        fit(field, 6.0)


@pytest.mark.parametrize("anchor", [0.0, 240 * 1024.0, -240 * 1024.0])
@pytest.mark.parametrize("error_m", [0.5, 20.0])
def test_the_bound_holds_up_to_500_km_from_the_anchor(anchor, error_m):
    """Walls of 9 km, 123.4 m apart, whose errors are those of rounded positions alone."""
    zigzag = np.where(np.arange(4097) % 2, 9000.0, 0.0) * np.ones((5, 1))
    field = anchored(from_array(zigzag.astype(np.float32), 123.4, 123.4), anchor, 0.0)
    fitted = fit(field, error_m)
    assert fitted.rounds and fitted.worst_m == 0.0
    x = fitted.surface.positions[:, 0].astype(np.float64)
    columns = np.rint((x + anchor) / 123.4 + 2048)
    moved = np.abs(x - ((columns - 2048) * 123.4 - anchor)).max() * 9000.0 / 123.4
    found = measure(field, fitted.surface, random_points=20_000, threads=1).vertical_max_m
    assert moved * (1 - 1e-9) <= found <= fitted.bound_m < 1.01 * moved
    assert moved > (0.9 if anchor else 0.45) and bool(fitted.limited) == (fitted.bound_m > error_m)
