# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiling images as detail, and details with masks: their bounds, and their meshes against numpy in float64."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import detail_bounds as bounds
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.displacement_layers import DisplacementLayer, DisplacementLayers, LayerMask
from adaptive_terrain.cbt_terrain.field.domain import make_domain
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS, with_detail
from adaptive_terrain.cbt_terrain.field.painted import Painted
from adaptive_terrain.cbt_terrain.field.tiled import Tiled
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from detail_scenes import WEIGHTS, assert_measured, check, ground_view
from detail_surface import image_heights, mask_values
from fields import extent, reference_heights
from invariants import arrays, assert_invariants

TRIANGLES = {1: [(-1, -1), (1, -1), (-1, 1)], 0: [(-1, -1), (1, -1), (0, 0)]}
AT = [int(np.flatnonzero((WEIGHTS == corner).all(1))[0]) for corner in np.eye(3)]


def image(rows, columns, rough=0.5, seed=1):
    """Return waves of all directions; waves of half the length have `rough` of the amplitude."""
    rng, z = np.random.default_rng(seed), np.zeros((rows, columns))
    y, x = np.mgrid[:rows, :columns]
    for k in range(1, 6):
        for a, b, phase in zip(*rng.integers(-(2**k), 2**k + 1, (2, 6)), rng.uniform(0, 7, 6), strict=True):
            z += rough**k * np.sin(2 * np.pi * (a * x / columns + b * y / rows) + phase)
    return Painted((z - z.min()) / np.ptp(z))


def bricks():
    """Return an image of two heights without any in between."""
    z = np.ones((32, 48), np.float32)
    z[::8] = z[:8, ::16] = z[8:16, 8::16] = z[16:24, ::16] = z[24:, 8::16] = 0.0
    return Painted(z)


def mask(shape, seed=3):
    rng = np.random.default_rng(seed)
    values = np.kron(rng.integers(0, 2, (shape[0] // 4 + 1, shape[1] // 4 + 1)), np.ones((4, 4)))
    return LayerMask((values[: shape[0], : shape[1]] * rng.integers(0, 256, shape)).astype(np.uint8))


IMAGES = {"smooth": image(64, 64), "rough": image(64, 96, 0.9), "odd": image(27, 50), "bricks": bricks()}


@pytest.mark.thorough
@pytest.mark.parametrize("name", IMAGES)
def test_bounds_of_images_hold(name):
    """Triangles of both kinds and all sizes, at random and where a search finds the image furthest from them."""
    tiled, steps, levels, rng = Tiled(0.3, 5.0, IMAGES[name]), (2.0, 3.0), 5, np.random.default_rng(7)
    table, ratios = bounds.tables(tiled.parts(1e-4), steps, levels, 0), []
    for depth in range(3, 27, 2):
        half = np.array(steps) * 2.0 ** (levels - (depth - 1) // 2) / 2
        largest = 0.0
        for corners in TRIANGLES.values():
            middle = rng.uniform(-500, 500, (300, 1, 2))
            for k in range(6):
                places = np.einsum("wc,cx->wx", WEIGHTS, np.array(corners) * half)[None] + middle
                heights = image_heights(tiled, places.reshape(-1, 2)).reshape(len(middle), -1)
                off = np.abs(heights - heights[:, AT] @ WEIGHTS.T).max(1)
                assert off.max() <= table[depth, 0]
                assert np.ptp(heights[:, AT], axis=1).max() <= table[depth, 1]
                largest = max(largest, off.max())
                best = middle[np.argsort(off)[-10:]]
                middle = np.concatenate(
                    [best, (best[None] + rng.normal(size=(9, 10, 1, 2)) * 0.5**k).reshape(-1, 1, 2)]
                )
        ratios.append(table[depth, 0] / largest)
    assert (np.diff(table, axis=0) <= 0).all()
    print(name, f"bound / largest seen: {min(ratios):.2f} .. {max(ratios):.2f}, mean {np.mean(ratios):.2f}")
    assert np.mean(ratios) < 4.0


def test_bounds_of_masked_details_hold_inside_cells():
    """Of every cell's own most, at random places in cells."""
    rng, steps = np.random.default_rng(8), (2.0, 3.0)
    lattice = from_array(np.zeros((13, 18), np.float32), *steps).lattice
    for tiled, near in ((Tiled(0.3, 5.0, IMAGES["rough"]), 6.0), (Tiled(1.0, 60.0, IMAGES["smooth"]), 20.0)):
        covered, ratios = mask((13, 18)), []
        table = bounds.tables(
            bounds.masked_terms(tiled.parts(1e-4), steps), steps, lattice.levels, 0, 2 * lattice.levels + 1
        )
        for depth in range(2 * lattice.levels + 1, 2 * lattice.levels + 14):
            half = np.array(steps) * 2.0 ** (lattice.levels - (depth - 1) // 2) / 2
            shape = np.array(TRIANGLES[depth % 2]) * half
            cell = np.stack([rng.integers(0, 17, 1500), rng.integers(0, 12, 1500)], 1)
            # a triangle's middle in its cell so that all of it is
            middle = (cell - np.array([8.5, 6.0]) + 0.5 + rng.uniform(-0.5, 0.5, (1500, 2))) * steps
            low, high = (cell - [8.5, 6.0]) * steps, (cell - [7.5, 5.0]) * steps
            middle = np.clip(middle, low + half, high - half)[:, None]
            places = (np.einsum("wc,cx->wx", WEIGHTS, shape)[None] + middle).reshape(-1, 2)
            heights = image_heights(tiled, places) * mask_values(covered, lattice, places)
            heights = heights.reshape(len(middle), -1)
            v = covered.values
            corners = np.stack([v[cell[:, 1] + b, cell[:, 0] + a] for a in (0, 1) for b in (0, 1)])
            most = corners.max(0) / 255
            off = np.abs(heights - heights[:, AT] @ WEIGHTS.T).max(1)
            assert (off <= most * table[depth, 0] + 1e-12).all()
            assert np.ptp(heights[:, AT], axis=1).max() <= table[depth, 1]
            ratios.append(table[depth, 0] / (off[most > 0] / most[most > 0]).max())
        print(f"bound / largest seen: {min(ratios):.2f} .. {max(ratios):.2f}, mean {np.mean(ratios):.2f}")
        assert np.mean(ratios) < near


def test_the_most_of_a_mask_is_that_of_every_block():
    for shape in ((2, 2), (2, 9), (7, 13), (33, 20)):
        covered = mask(shape)
        v, level = covered.values, 0
        columns, rows, at = shape[1] - 1, shape[0] - 1, 0
        while True:
            side = 2**level
            for j in range(rows):
                for i in range(columns):
                    block = v[j * side : (j + 1) * side + 1, i * side : (i + 1) * side + 1]
                    assert covered.max_cells[at + j * columns + i] == block.max()
            at += rows * columns
            if rows * columns == 1:
                break
            columns, rows, level = (columns + 1) // 2, (rows + 1) // 2, level + 1
        assert at == len(covered.max_cells)
        domain = make_domain(
            field_of(shape, DisplacementLayers((DisplacementLayer(Detail(1.0), covered),))), 0, 1.0, 0.0
        )
        assert domain.mask_first.numpy()[-1] == at and domain.mask_top == level


def field_of(shape, ground, interpolation="bilinear"):
    z = np.cumsum(np.cumsum(np.random.default_rng(len(shape)).standard_normal(shape), 0), 1) * 0.1
    return with_detail(interpolated(from_array(z.astype(np.float32), 2.0, 3.0), interpolation), ground)


def grounds(shape):
    """Return displacement layers of every kind, by name."""
    return {
        "an image": Tiled(0.2, 5.0, IMAGES["smooth"]),
        "bricks in places": DisplacementLayers((DisplacementLayer(Tiled(0.3, 4.0, IMAGES["bricks"]), mask(shape)),)),
        "noise in places": DisplacementLayers((DisplacementLayer(Detail(0.3, 3.0), mask(shape, 4)),)),
        "three": DisplacementLayers(
            (
                DisplacementLayer(Tiled(0.1, 3.0, IMAGES["rough"]), mask(shape, 5)),
                DisplacementLayer(Detail(0.1, 6.0, 0.5, 2)),
                DisplacementLayer(Tiled(2.0, 90.0, IMAGES["odd"]), mask(shape, 6)),
            )
        ),
    }


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "shape"), [*enumerate([(33, 33), (27, 40), (9, 65)])])
def test_no_error_is_above_its_bound(number, shape):
    rng, parts = np.random.default_rng(shape[1]), []
    for ground in grounds(shape).values():
        number += 1
        field = field_of(shape, ground, INTERPOLATIONS[number % 2])
        scale, offset = float(rng.choice([1.0, -2.0, 0.3])), float(rng.choice([0.0, 700.0]))
        eye = np.array([*(rng.uniform(-0.4, 0.4, 2) * extent(field)[:2]), 0.0])
        eye[2] = reference_heights(field, eye[None, :2])[0] * scale + offset + 1.5 + 2 * ground.amplitude * abs(scale)
        view = View.look(eye, -eye * [1, 1, 0] + [0, 0, offset], fov_deg=50.0, resolution=(320, 180), clip=(5e-3, 1e6))
        meshlet, threads = int(rng.integers(3)), int(rng.integers(1, 4))
        for asked in (
            {"error_px": 1.0, "meshlet": meshlet},
            {"error_px": 0.0, "error_m": 0.3 * ground.amplitude * abs(scale)},
            {"error_px": 2.0, "max_depth": 12},
            {"error_px": 0.0, "error_m": 0.01, "max_depth": 9},
        ):
            criterion = Criterion(**asked, max_triangles=3000)
            found = Terrain(field, threads).update(criterion, [view], None, scale, offset)
            assert_invariants(found.surface, field.lattice, asked.get("meshlet", 0))
            parts.append(check(found, field, [view], None, scale, offset))
    print(shape, f"largest seen / bound: mean {np.mean(parts):.2f}, most {max(parts):.2f}")
    assert np.mean(parts) > 0.1


def test_vertices_and_normals_are_those_of_the_coats():
    """Normals off the raster's lines, where slopes of a mask have no steps, on level ground."""
    ground, h = grounds((33, 33))["three"], 1e-4
    field = with_detail(from_array(np.zeros((33, 33), np.float32), 2.0, 3.0), ground)
    surface = Terrain(field, 1).update(Criterion(error_px=0.5, max_triangles=20_000), [ground_view(field)]).surface
    p = surface.positions.astype(np.float64)
    assert np.abs(p[:, 2] - reference_heights(field, p[:, :2])).max() < 2e-6
    cells = p[:, :2] / [2.0, 3.0]
    inside = (np.abs(cells - np.round(cells)) > 1e-3).all(1)
    p, normals = p[inside], surface.normals[inside].astype(np.float64)
    slopes = -normals[:, :2] / normals[:, 2:]
    ahead, behind = (
        np.stack([reference_heights(field, p[:, :2] + s * h * axis) for axis in np.eye(2)], 1) for s in (1, -1)
    )
    assert len(p) > 1000 and np.abs(slopes - (ahead - behind) / (2 * h)).max() < 1e-3


def test_a_mesh_depends_on_neither_threads_nor_history():
    field = field_of((27, 40), grounds((27, 40))["three"])
    criterion, view = Criterion(error_px=1.0, max_triangles=20_000), ground_view(field)
    wanted = arrays(Terrain(field, 1).update(criterion, [view]).surface)
    for threads in (2, 3):
        terrain = Terrain(field, threads)
        terrain.update(criterion, [ground_view(field, above=30.0, at=(-0.3, 0.3))])
        assert arrays(terrain.update(criterion, [view]).surface) == wanted


def test_where_a_mask_is_0_the_mesh_is_that_without_detail():
    covered = np.zeros((33, 33), np.uint8)
    covered[:, 20:] = 255
    field = field_of(
        (33, 33), DisplacementLayers((DisplacementLayer(Tiled(0.3, 4.0, IMAGES["bricks"]), LayerMask(covered)),))
    )
    plain = with_detail(field, None)
    view = View.look((-20.0, -40.0, 12.0), (-20.0, 0.0, 0.0), fov_deg=20.0, resolution=(320, 180), clip=(0.1, 1e6))
    criterion = Criterion(error_px=1.0, off_screen_factor=1000.0, guard_deg=0.0)
    one, two = (Terrain(f, 1).update(criterion, [view]).triangles for f in (field, plain))
    assert two <= one < 1.3 * two, "what is off the frame, or masked, takes next to nothing"
    nothing = field_of(
        (33, 33), DisplacementLayers((DisplacementLayer(Detail(0.3), LayerMask(np.zeros((33, 33), np.uint8))),))
    )
    found = [Terrain(f, 1).update(Criterion(error_px=1.0), [ground_view(f)]) for f in (nothing, plain)]
    assert found[0].triangles <= 1.1 * found[1].triangles  # boxes are taller by the amplitude


def test_pixels_that_no_leaf_can_show_are_smoothed_away():
    """On 40 km of ground float32 holds no 2 mm: the net that is left has fewer pixels, and the bound still falls."""
    fine = Tiled(0.1, 0.5, image(256, 256))
    near, far = fine.packed(1e-4), fine.packed(5e-3)
    assert near[1].shape == (256, 256) and far[1].shape == (32, 32)
    assert far[0].frequency == near[0].frequency / 8
    table = bounds.tables(fine.parts(5e-3), (40.0, 40.0), 5, 0)
    deepest = next(d for d in range(64) if bounds.radius_at((40.0, 40.0), 5, d + 1) < 5e-3)
    assert table[deepest, 0] < 0.5 * table[0, 0]


def test_the_measurement_sees_what_numpy_sees():
    field = field_of((27, 40), grounds((27, 40))["three"])
    assert_measured(field, Criterion(error_px=4.0, error_m=0.6, max_triangles=1000))


def test_what_cannot_be_is_refused_in_a_sentence():
    with pytest.raises(TerrainError, match="The detail's tile is 0.0; expected 0.001 .. 1e\\+06 metres"):
        Tiled(0.1, 0, IMAGES["smooth"])
    with pytest.raises(TerrainError, match="image has 4,196,352 pixels; expected 4,194,304 at most"):
        Tiled(0.1, 1.0, Painted(np.zeros((2049, 2048), np.float32)))
    field = field_of((9, 9), DisplacementLayers((DisplacementLayer(Detail(0.1), mask((9, 10))),)))
    with pytest.raises(TerrainError, match="A mask of displacement has the shape"):
        Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1.0))


def test_keys_tell_grounds_apart():
    shape = (9, 9)
    made = [*grounds(shape).values(), *grounds((9, 10)).values(), Tiled(0.2, 5.1, IMAGES["smooth"]), Detail(0.2)]
    # "an image" is there twice
    assert len({ground.key for ground in made}) == len({hash(ground) for ground in made}) == len(made) - 1
