# SPDX-License-Identifier: GPL-3.0-or-later
"""The bicubic surface of the displacement and that of the measurement against Bezier patches in numpy."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.codes import pack_samples
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.kernels.accuracy.cubic import cubic_at, height_bounds
from adaptive_terrain.kernels.bicubic.surface import in_patch
from adaptive_terrain.kernels.field.cells import on_sample
from adaptive_terrain.kernels.field.codes import Samples
from fields import bezier

wp.set_module_options({"enable_backward": False})
SHAPES = [(2, 2), (2, 5), (3, 9), (9, 25)]


@wp.kernel
def evaluate(
    offset: wp.int32,
    samples: Samples,
    cell: wp.array(dtype=wp.vec2i),
    place: wp.array(dtype=wp.vec2d),
    found: wp.array(dtype=wp.vec3d),
    measured: wp.array(dtype=wp.vec3d),
):
    p = offset + wp.tid()
    i = cell[p][0]
    j = cell[p][1]
    found[p] = in_patch(samples, i, j, place[p][0], place[p][1])
    low, high = height_bounds(samples, i, j)
    measured[p] = wp.vec3d(low, cubic_at(samples, i, j, place[p][0], place[p][1]), high)


@wp.kernel
def at_samples(
    offset: wp.int32,
    samples: Samples,
    found: wp.array(dtype=wp.vec3d),
):
    p = offset + wp.tid()
    found[p] = on_sample(samples, p % samples.columns, p / samples.columns)


def surfaces(field: HeightField, cell: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return at `place` (0 .. 1) in each cell height and gradient a cell of one evaluation, (low, height, high) of the
    other."""
    rows, columns = field.samples.shape
    found, measured = np.zeros((len(cell), 3)), np.zeros((len(cell), 3))
    arrays = [(np.ascontiguousarray(cell, np.int32), wp.vec2i), (np.ascontiguousarray(place, np.float64), wp.vec2d)]
    arrays += [(found, wp.vec3d), (measured, wp.vec3d)]
    inputs = [pack_samples(field.samples, field.steps)]
    inputs += [wp.array(array, dtype=dtype, device="cpu", copy=False) for array, dtype in arrays]
    launch.spread(evaluate, len(cell), inputs, step="test")
    return found, measured


def random_field(shape, seed=0) -> HeightField:
    return from_array((100 * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32), 1.0)


def to_plane(field, place):
    """Return places in samples from the south-west as points of the terrain's own space."""
    lattice = field.lattice
    middle = np.array([lattice.width - 1, lattice.height - 1]) / 2
    return (place - middle) * [lattice.step_x, lattice.step_y]


@pytest.mark.parametrize("shape", SHAPES)
def test_both_evaluations_are_the_bezier_patches(shape):
    field = random_field(shape)
    rng = np.random.default_rng(1)
    cell = np.stack([rng.integers(shape[1] - 1, size=4000), rng.integers(shape[0] - 1, size=4000)], axis=1)
    place = rng.random((4000, 2))
    place[:400] = np.round(place[:400])
    height, gradient = bezier(field, to_plane(field, cell + place), cell)
    found, measured = surfaces(field, cell, place)
    assert np.abs(found[:, 0] - height).max() < 1e-12 * 300
    assert np.abs(found[:, 1:] - gradient).max() < 1e-12 * 1000
    assert np.abs(measured[:, 1] - height).max() < 1e-12 * 300
    assert (measured[:, 0] <= height).all() and (height <= measured[:, 2]).all()


@pytest.mark.parametrize("shape", SHAPES[1:])
def test_heights_and_gradients_agree_on_both_sides_of_a_border(shape):
    field, t = random_field(shape, 2), np.linspace(0, 1, 9)
    for axis in (0, 1):
        cells = np.array(shape)[::-1] - 1 - np.eye(2, dtype=int)[axis]
        i, j, k = (a.reshape(-1) for a in np.meshgrid(*(np.arange(n) for n in (*cells, 9)), indexing="ij"))
        cell, along = np.stack([i, j], axis=1), np.zeros((len(i), 2))
        along[:, 1 - axis] = t[k]
        before, after = along.copy(), along
        before[:, axis] = 1.0
        one, _ = surfaces(field, cell, before)
        two, _ = surfaces(field, cell + np.eye(2, dtype=int)[axis], after)
        assert len(i) == 0 or np.abs(one - two).max() < 1e-12 * 1000


@pytest.mark.parametrize("shape", SHAPES)
def test_the_gradient_at_samples_is_the_central_difference(shape):
    field = random_field(shape, 3)
    rows, columns = shape
    expected = np.zeros((rows * columns, 3))
    samples = pack_samples(field.samples, field.steps)
    inputs = [samples, wp.array(expected, dtype=wp.vec3d, device="cpu", copy=False)]
    launch.spread(at_samples, rows * columns, inputs, step="test")
    j, i = np.divmod(np.arange(rows * columns), columns)
    for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
        cell = np.clip(np.stack([i, j], axis=1) - corner, 0, np.array([columns, rows]) - 2)
        found, _ = surfaces(field, cell, np.stack([i, j], axis=1) - cell)
        assert np.array_equal(expected[:, 0], field.samples.reshape(-1))
        assert np.abs(found - expected).max() < 1e-12 * 1000


def test_planes_are_exact_and_biquadratics_inside():
    y, x = np.indices((9, 17)).astype(float)
    rng = np.random.default_rng(4)
    cell = np.stack([rng.integers(16, size=3000), rng.integers(8, size=3000)], axis=1)
    place = rng.random((3000, 2))
    u, v = (cell + place).T
    inner = ((cell > 0) & (cell < [15, 7])).all(axis=1)
    for power, where in ((1, slice(None)), (2, inner)):

        def surface(x, y, power=power):
            return 3.0 - 2.0 * x + 0.5 * y + (power - 1) * (0.25 * x * x - y * y + 2 * x * y + x * x * y * y / 16)

        field = from_array(surface(x, y).astype(np.float32))
        assert np.array_equal(field.samples, surface(x, y))
        found, measured = surfaces(field, cell, place)
        assert np.abs(found[where, 0] - surface(u, v)[where]).max() < 1e-11
        assert np.abs(measured[where, 1] - surface(u, v)[where]).max() < 1e-11
    assert inner.sum() > 1000 and np.abs(found[~inner, 0] - surface(u, v)[~inner]).max() > 0.01


def test_a_step_overshoots_by_an_eighth_a_constant_does_not():
    box = np.tile(np.float32([0, 0, 1, 1, 0, 0]), (4, 1))
    middle = np.array([[2, 1]]), np.array([[0.5, 0.5]])
    assert surfaces(from_array(box), *middle)[0][0, 0] == 1.125
    flat = surfaces(from_array(np.full((4, 6), -431.1, np.float32)), *middle)[0][0]
    assert flat[0] == np.float32(-431.1) and not flat[1:].any()
