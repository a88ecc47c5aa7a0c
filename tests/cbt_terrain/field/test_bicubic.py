# SPDX-License-Identifier: GPL-3.0-or-later
"""The bicubic surface of a height field: its errors, ranges and meshes against Bezier patches in numpy."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.interpolation import interpolation
from adaptive_terrain.cbt_terrain.accuracy.measure import measure, triangle_errors
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import bicubic, bicubic_errors
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS, HeightField
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from diamond_entries import entry_at, error_index, range_index
from fields import bezier, bezier_heights, errors_of, mesh_heights, ranges_of, reference_heights, rough
from invariants import arrays, assert_invariants
from rasters import jacksboro
from scenarios import eager_threads, make_field

KINDS = ("rough", "noise", "spike", "cliff", "checkerboard", "twist", "plane", "constant")


def field_of(kind, shape, relief=100.0, base=0.0, steps=(2.0, 3.0), seed=1) -> HeightField:
    asked = {"kind": kind, "shape": shape, "seed": seed, "relief": relief, "base": base, "steps": steps}
    return interpolated(make_field(asked), "bicubic")


def dense(field, per_cell=16):
    """Return points [n, 2] of the terrain's space, `per_cell` to a cell's side."""
    lattice = field.lattice
    i, j = (np.arange((n - 1) * per_cell + 1) / per_cell - (n - 1) / 2 for n in (lattice.width, lattice.height))
    return np.stack(np.meshgrid(i * lattice.step_x, j * lattice.step_y), axis=-1).reshape(-1, 2)


def triangles_of(lattice, deepest):
    """Left, apex and right corners float64 [n, 3, 2], in cells, of all triangles of each depth."""
    side = float(1 << lattice.levels)
    roots = np.array([[(0, side), (0, 0), (side, 0)], [(side, 0), (side, side), (0, side)]])
    squares = np.stack(np.meshgrid(np.arange(lattice.columns), np.arange(lattice.rows)), axis=-1).reshape(-1, 1, 1, 2)
    corners = (roots + squares * side).reshape(-1, 3, 2)
    for depth in range(1, deepest + 1):
        yield depth, corners
        left, apex, right = corners.swapaxes(0, 1)
        middle = (left + right) / 2
        corners = np.concatenate([np.stack([left, middle, apex], 1), np.stack([apex, middle, right], 1)])


def error_at(field, middle, depth):
    """Return the stored errors of diamonds that are split at `middle` [n, 2], in cells."""
    lattice, errors = field.lattice, errors_of(field)
    if depth < lattice.cell_depth:
        return errors[error_index(lattice, depth, *middle.T.astype(int))]
    found = np.zeros(len(middle))
    base = 0 if depth == lattice.cell_depth else lattice.node_count - lattice.cell_base
    for shift in ((0, 0), (1e-9, 0), (0, 1e-9)):  # a middle on a side belongs to both cells
        cell = np.clip(np.floor(middle - shift).astype(int), 0, [lattice.width - 2, lattice.height - 2])
        found = np.maximum(found, errors[error_index(lattice, lattice.cell_depth, *cell.T) + base])
    return found / 2.0 ** (depth - lattice.cell_depth)


LARGE = "cliff", "twist"  # of two squares


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        *((kind, (3, 3)) for kind in KINDS),
        *((kind, shape) for kind in LARGE for shape in ((2, 4), (5, 9))),
        *(
            pytest.param(kind, shape, marks=pytest.mark.thorough)
            for kind in KINDS
            for shape in ((2, 4), (5, 9))
            if kind not in LARGE
        ),
    ],
)
def test_all_triangles_are_within_their_errors_and_ranges(kind, shape):
    field = field_of(kind, shape, base=8000.0)
    lattice = field.lattice
    steps, cells = np.array([lattice.step_x, lattice.step_y]), np.array([lattice.width - 1, lattice.height - 1])
    ranges = field.range_base + np.stack(ranges_of(field), axis=-1) * field.range_step
    cells_at = range_index(lattice, lattice.cell_depth, *np.indices(cells))
    patches = field.range_base + field.ranges[cells_at] * field.range_step
    a, b = (w.reshape(-1) for w in np.meshgrid(np.arange(13), np.arange(13)))
    weights = np.stack([a, b, 12 - a - b], axis=1)[a + b <= 12] / 12
    tiny, ratios, above = 1e-11, [], None  # what float64 rounds here
    for depth, corners in triangles_of(lattice, lattice.cell_depth + 6):
        places = np.einsum("wc,tcx->twx", weights, corners).reshape(-1, 2)
        heights = bezier_heights(field, (places - cells / 2) * steps).reshape(len(corners), -1)
        at_corners = heights[:, [np.flatnonzero(weights[:, c] == 1)[0] for c in range(3)]]
        off = np.abs(at_corners @ weights.T - heights).max(axis=1)
        middle = (corners[:, 0] + corners[:, 2]) / 2
        error = error_at(field, middle, depth)
        assert (off <= error + tiny).all()
        ratios.append((off / np.maximum(error, 1e-30)).max())
        if depth <= lattice.cell_depth:
            i, j = middle.T.astype(int)
            low, high = (ranges[j, i] if depth < lattice.cell_depth else patches[i, j]).T
            assert (low <= heights.min(axis=1) + tiny).all() and (heights.max(axis=1) - tiny <= high).all()
            if above is not None:  # each triangle has its first half, then all have their second
                assert (np.tile(above[0], 2) <= low).all() and (high <= np.tile(above[1], 2)).all()
            above = low, high
        else:
            assert (error_at(field, corners[:, 1], depth - 1) >= error - tiny).all()
    if kind == "constant":
        assert not field.error.any()
    elif kind != "plane":  # of which only what float32 makes of it bends
        assert min(ratios[lattice.cell_depth + 2 :]) > 0.38 and max(ratios[lattice.cell_depth + 2 :]) > 0.58


@pytest.mark.parametrize("kind", ["rough", "cliff"])
def test_errors_of_meshlets_are_those_of_what_is_drawn(kind):
    field = field_of(kind, (5, 9))
    lattice = field.lattice
    P = dense(field, 16)
    truth = bezier_heights(field, P)
    for meshlet in (1, 2, 3):
        errors = error_for(field, meshlet)
        assert errors.shape == field.error.shape and (errors <= field.error).all()
        drawn = replace(field, error=errors)
        for depth in (lattice.cell_depth - 1, lattice.cell_depth + 1):
            bound = max(
                error_at(drawn, (c[:, 0] + c[:, 2]) / 2, d).max() for d, c in triangles_of(lattice, depth) if d == depth
            )
            found = Terrain(field, 1).update(
                Criterion(error_px=0, error_m=1e-6, max_depth=depth + 2 * meshlet, meshlet=meshlet)
            )
            off = np.abs(mesh_heights(found.surface, P) - truth).max()
            assert off <= bound + 1e-4 and bound <= found.bound_m <= 1.0011 * bound  # the search for it ends there


@pytest.mark.parametrize("meshlet", [0, 1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_below_the_cells_errors_are_nested(kind, meshlet):
    field = field_of(kind, (9, 17))
    lattice, errors = field.lattice, errors_of(field, meshlet)
    j, i = np.indices((lattice.height - 1, lattice.width - 1))
    own = error_index(lattice, lattice.cell_depth, i, j)
    error, bend = errors[own], errors[own + lattice.node_count - lattice.cell_base]
    assert (error >= bend / 2).all()
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        for one, two in ((a, b), (b, a)):
            assert (error[one] >= bend[two] / 2).all() and (bend[one] >= bend[two] / 2).all()


@pytest.mark.thorough
@pytest.mark.parametrize(("relief", "base"), [(100.0, 0.0), (1e-3, 0.0), (30.0, 8000.0), (1e6, -500.0)])
@pytest.mark.parametrize("kind", KINDS[:6])
def test_vertices_lie_on_the_surface_and_carry_its_normals(kind, relief, base):
    for shape in ((5, 9), (9, 9), (2, 4)):
        field = field_of(kind, shape, relief, base)
        for criterion in (
            Criterion(error_px=0, error_m=relief / 1000),
            Criterion(error_px=0, error_m=relief / 100, meshlet=2),
        ):
            update = Terrain(field, 1).update(criterion)
            surface = update.surface
            assert_invariants(surface, field.lattice, criterion.meshlet)
            heights, gradient = bezier(field, surface.positions[:, :2].astype(np.float64))
            # plane coordinates of these fields are exact in float32, so heights differ by rounding alone
            highest = max(abs(field.min_height), abs(field.max_height))
            assert np.abs(surface.positions[:, 2] - heights).max() <= 0.51 * np.spacing(np.float32(highest))
            normals = np.c_[-gradient, np.ones(len(gradient))]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            assert np.abs(surface.normals - normals).max() < 2e-7


def test_heights_are_scaled_and_shifted():
    field = field_of("rough", (9, 9))
    update = Terrain(field, 1).update(Criterion(error_px=0, error_m=1.0), (), None, -2.5, 100.0)
    heights = bezier_heights(field, update.surface.positions[:, :2].astype(np.float64))
    assert np.abs(update.surface.positions[:, 2] - (100.0 - 2.5 * heights)).max() < 1e-4
    points = dense(field, 16)
    off = np.abs(mesh_heights(update.surface, points) - (100.0 - 2.5 * bezier_heights(field, points))).max()
    assert 0.5 < off <= update.bound_m <= 1.0


def test_a_plane_takes_the_triangles_that_it_takes_as_bilinear():
    for steps in ((1.0, 1.0), (0.1, 7.3)):
        field = field_of("plane", (33, 65), steps=steps, seed=3)
        exact = from_array((np.arange(65.0) * 4 - np.arange(33.0)[:, None]).astype(np.float32), *steps)
        for surface in (field, interpolated(exact, "bicubic")):
            for error_m in (1e-3, 1e-1):
                both = [
                    Terrain(interpolated(surface, name), 1).update(Criterion(error_px=0, error_m=error_m))
                    for name in INTERPOLATIONS
                ]
                assert both[0].triangles == both[1].triangles


@pytest.mark.thorough
def test_edges_and_areas_are_within_their_bounds_below_the_cells():
    for kind in ("rough", "noise", "spike"):
        field = field_of(kind, (5, 9), relief=20.0, steps=(10.0, 10.0))
        view = View.look((30, -60, 60), (0, 0, 0), kind=ORTHOGRAPHIC, ortho_width=100.0, resolution=(800, 600))
        for asked in ({"edge_px": 12.0}, {"area_px": 60.0}, {"edge_px": 30.0, "error_px": 0.5, "meshlet": 1}):
            update = Terrain(field, 1).update(Criterion(**{"error_px": 0.0, **asked}), [view])
            surface = update.surface
            camera = surface.positions.astype(np.float64) @ view.world_to_camera[:3, :3].T
            pixels = camera[:, :2] * 8.0
            lengths = np.linalg.norm(np.diff(pixels[surface.edges], axis=1), axis=-1)
            assert surface.level.max() > field.lattice.cell_depth
            if "meshlet" not in asked:
                assert lengths.max() <= (update.bound_edge_px or np.inf)
                u, v = (pixels[surface.triangles[:, k]] - pixels[surface.triangles[:, 0]] for k in (1, 2))
                assert np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).max() / 2 <= (update.bound_area_px or np.inf)
            assert (update.bound_px is None) == ("error_px" not in asked)
            if "error_px" in asked:
                assert triangle_errors(field, surface, [view]).max() <= np.float32(update.bound_px)


@pytest.mark.parametrize("below", [1, 3, 5, 7])
def test_edges_up_a_wall_are_within_their_bound(below):
    """Between the levels of a step a patch climbs one and a half times as fast as its range of heights says."""
    field = field_of("cliff", (5, 9), relief=1000.0, steps=(1.0, 1.0))
    view = View.look((0, -1000, 500), (0, 0, 500), kind=ORTHOGRAPHIC, ortho_width=1200.0, resolution=(2400, 2400))
    asked = Criterion(error_px=0.0, edge_px=1.0, max_depth=field.lattice.cell_depth + below)
    update = Terrain(field, 1).update(asked, [view])
    heights = update.surface.positions[:, 2].astype(np.float64)[update.surface.edges] * 2.0
    longest = np.abs(heights[:, 0] - heights[:, 1]).max()
    assert 0.25 * update.bound_edge_px < longest <= update.bound_edge_px


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_between_both_surfaces_is_bounded(kind):
    field = field_of(kind, (5, 9))
    bilinear, lattice = interpolated(field, "bilinear"), field.lattice
    if kind == "rough":
        bilinear = from_array(np.tile(np.arange(9, dtype=np.float32) ** 2, (5, 1)))
        lattice = bilinear.lattice
    window = bicubic_errors._compute_tile(bilinear, ((0, lattice.cells_x), (0, lattice.cells_y)), 1)
    points = dense(bilinear, 8)
    apart = np.abs(bezier_heights(bilinear, points) - reference_heights(bilinear, points))
    apart = apart.reshape((lattice.height - 1) * 8 + 1, -1)
    j, i = np.indices((lattice.height - 1, lattice.width - 1))
    found = window.off[entry_at(np.zeros(1, int), [1], 0, 0, i, j)]
    largest = np.max(
        [apart[a : -8 + a or None : 8, b : -8 + b or None : 8] for a in range(9) for b in range(9)], axis=0
    )
    assert (largest <= found + 1e-12).all()
    if kind == "rough":  # x^2 is a quarter above its chords, away from the border
        assert found[:, 1:-1] == pytest.approx(0.25, rel=1e-6)
    assert found.max() <= 3.0 * largest.max()


def built_bytes(field, threads=1):
    """Return the arrays of a field's bicubic surface as bytes, by name."""
    made = {name: np.zeros(*of) for name, of in bicubic.arrays_of(field.lattice).items()}
    bicubic.build(field, made, threads)
    return {name: array.tobytes() for name, array in made.items()}


def spikes(shape):
    """Planar ground but for three samples, where curvatures reach over all of the raster."""
    random, samples = np.random.default_rng(5), np.zeros(shape, np.float32)
    samples[random.integers(shape[0], size=3), random.integers(shape[1], size=3)] = (3.0, 50.0, 1000.0)
    return from_array(samples)


@pytest.mark.parametrize("shape", [(150, 100), pytest.param((129, 65), marks=pytest.mark.thorough), (40, 200)])
@pytest.mark.parametrize("make", [lambda shape: rough(*shape), spikes])
def test_tiles_do_not_change_the_bytes(shape, make, monkeypatch):
    field = make(shape)
    whole = built_bytes(field)
    monkeypatch.setattr(bicubic_errors, "TILE", 64)
    assert built_bytes(field) == whole


def test_a_tile_beside_planar_ground_needs_distant_cells(monkeypatch):
    field = spikes((300, 200))
    whole = built_bytes(field)
    monkeypatch.setattr(bicubic_errors, "TILE", 64)
    monkeypatch.setattr(bicubic_errors, "_smallest", lambda *_: np.inf)
    assert built_bytes(field) != whole


@pytest.mark.thorough
def test_a_bicubic_surface_takes_the_memory_of_one_tile(monkeypatch):
    """Four times the samples take the same memory above the arrays themselves."""
    monkeypatch.setattr(bicubic_errors, "TILE", 128)
    built_bytes(rough(33, 33))  # compiles
    above = []
    for side in (385, 769):
        field = rough(side, side)
        made = {name: np.zeros(*of) for name, of in bicubic.arrays_of(field.lattice).items()}
        tracemalloc.start()
        bicubic.build(field, made, 1)
        above.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert above[1] < 1.2 * above[0]
    assert above[0] < 80 * 256 * 256  # bytes a cell of a window


def test_the_same_bytes_for_any_number_of_threads():
    field = rough(33, 65)
    view = View.look((0, -400, 120), (0, 0, 0))
    with eager_threads():
        built = [built_bytes(field, threads) for threads in (1, 2, 7)]
        assert built[0] == built[1] == built[2]
        meshes = []
        for threads in (1, 2, 7):
            terrain = Terrain(interpolated(field, "bicubic"), threads)
            terrain.update(Criterion(error_px=3.0), [view])  # so that there is something to cut
            update = terrain.update(Criterion(error_px=0.5), [view])
            meshes.append((arrays(update.surface), update.bound_px, update.bound_m))
        assert meshes[0] == meshes[1] == meshes[2]


def test_interpolations_are_made_once_and_know_each_other():
    field = rough(17, 17)
    cubic = interpolated(field, "bicubic")
    assert interpolated(field, "bilinear") is field and interpolated(field, "bicubic") is cubic
    assert interpolated(cubic, "bicubic") is cubic and interpolated(cubic, "bilinear") is field
    assert cubic.samples is field.samples and cubic.key != field.key
    assert (field.interpolation, cubic.interpolation) == ("bilinear", "bicubic")
    assert cubic.steepest_x >= field.steepest_x and cubic.max_height >= field.max_height
    for name in ("cubic", "", None):
        with pytest.raises(TerrainError, match="expected bilinear or bicubic"):
            interpolated(field, name)


def test_a_fit_is_of_the_bilinear_surface_alone():
    with pytest.raises(TerrainError, match="choose bilinear"):
        fit(interpolated(rough(17, 17), "bicubic"), 1.0)


def test_a_mesh_is_off_the_other_surface_by_their_distance():
    bilinear, cubic = (interpolated(rough(33, 33), name) for name in INTERPOLATIONS)
    update = Terrain(cubic, 1).update(Criterion(error_px=0, error_m=0.2))
    assert 0.1 < measure(cubic, update.surface, random_points=1000).vertical_max_m <= update.bound_m <= 0.2
    points = dense(cubic, 8)
    apart = np.abs(bezier_heights(cubic, points) - reference_heights(bilinear, points)).max()
    found = measure(bilinear, update.surface, random_points=1000).vertical_max_m
    assert apart - 0.2 <= found <= apart + 0.25 and apart >= interpolation(bilinear).max > 1.0


def test_the_outline_of_a_wall_is_where_the_surface_overshoots():
    """Seen across a wall of two rows: bicubic stands an eighth above its samples, 10 m at 2 pixels a metre."""
    heights = np.tile(np.float32([0, 0, 0, 0, 80, 80, 0, 0, 0]), (9, 1))
    field = from_array(heights, 10.0)
    view = View.look((-200, 0, 40), (0, 0, 40), kind=ORTHOGRAPHIC, ortho_width=120.0, resolution=(160, 240))
    for own, other in (INTERPOLATIONS, INTERPOLATIONS[::-1]):
        fine = Terrain(interpolated(field, own), 1).update(Criterion(error_px=0, error_m=0.02)).surface
        assert measure(interpolated(field, own), fine, view, random_points=0).silhouette_px.p95 < 0.1
        assert measure(interpolated(field, other), fine, view, random_points=0).silhouette_px.p95 == pytest.approx(
            20, abs=0.2
        )


@pytest.mark.parametrize(
    "asked", [40.0, 4.0, *(pytest.param(metres, marks=pytest.mark.thorough) for metres in (10.0, 1.0, 0.25))]
)
def test_the_vertical_bound_is_not_wasteful(asked):
    field = interpolated(from_array(jacksboro()[:65, :97], 30.0), "bicubic")
    found = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked))
    off = measure(field, found.surface, random_points=0).vertical_max_m
    assert 0.6 * asked < off <= found.bound_m <= asked
