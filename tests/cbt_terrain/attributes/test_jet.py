# SPDX-License-Identifier: GPL-3.0-or-later
"""What a jet gives, against surfaces whose derivatives are known and against sums in numpy; at rims and in holes."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.attributes.jet import OUTPUTS, make
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.derived_arrays import samples_by_level
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from padded import raster

ALL = {name: {} for name in OUTPUTS}


def made(field, x, y, level=0.0, scale=1.0, offset=0.0, threads=1) -> dict[str, np.ndarray]:
    """Compute all attributes at x, y metres."""
    positions = np.stack([np.ravel(x), np.ravel(y), np.zeros(np.size(x))], 1).astype(np.float32)
    levels = np.broadcast_to(np.asarray(level, np.float32), len(positions)).copy()
    return make(SamplePoints(field, positions, levels, scale, offset, threads), ALL, {})


def places_in(field, count: int, inset: float = 0.0) -> np.ndarray:
    """float64 [2, count]: random places of the raster, its corners first."""
    west, south, east, north = field.lattice.rectangle()
    x, y = np.random.default_rng(5).uniform(inset, 1 - inset, (2, count))
    x[:4], y[:4] = [inset, 1 - inset, inset, 1 - inset], [inset, inset, 1 - inset, 1 - inset]
    xy = np.array([west + x * (east - west), south + y * (north - south)])
    return xy.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("shape", [(65, 65), (40, 99), (2, 2), (3, 50)])
def test_a_plane_is_exact_at_every_level(shape):
    """Steps differ, the vertical scale turns it over: the slope, direction and normal are those of the plane."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    field = from_array((100 + 6.0 * x + 10.0 * y).astype(np.float32), 10.0, 20.0)
    x, y = places_in(field, 500)
    west, south, _, _ = field.lattice.rectangle()
    level = np.random.default_rng(1).integers(0, 8 * len(samples_by_level(field.lattice)) + 20, 500) / 8
    found = made(field, x, y, level, scale=-2.0, offset=7.0)
    gx, gy = -1.2, -1.0
    np.testing.assert_allclose(found["height"], 7 - 200 + gx * (x - west) + gy * (y - south), atol=2e-3)
    np.testing.assert_allclose(found["slope"], np.arctan(np.hypot(gx, gy)), atol=1e-6)
    np.testing.assert_allclose(found["aspect"], np.tile([-gx, -gy] / np.hypot(gx, gy), (500, 1)), atol=1e-6)
    normal = np.array([-gx, -gy, 1]) / np.sqrt(1 + gx**2 + gy**2)
    np.testing.assert_allclose(found["detail_normal"], np.tile(normal, (500, 1)), atol=1e-6)
    for name in ("mean_curvature", "profile_curvature", "plan_curvature"):
        assert abs(found[name]).max() < 1e-6


def hill(x, y):
    """Return a hill and its derivatives, float64: z, zx, zy, zxx, zxy, zyy."""
    a, b = 260.0, 170.0
    z = 90.0 * np.exp(-((x / a) ** 2) - (y / b) ** 2)
    p, q = -2 * x / a**2, -2 * y / b**2
    return z, p * z, q * z, (p * p - 2 / a**2) * z, p * q * z, (q * q - 2 / b**2) * z


@pytest.mark.parametrize(("level", "accuracy"), [(0.0, 1.0), (1.0, 5.5), (1.625, 16.8)])
def test_a_hill_has_its_analytic_derivatives(level, accuracy):
    """Away from samples, which are 2 m apart. `accuracy`: the variance of a level's weights, of level 0 the spline's
    (1/3 squared samples), of level 1 [1 2 1]'s (1/2) and that of a spline of twice the width (4/3), and so on."""
    i, j = np.meshgrid(np.arange(401) - 200.0, np.arange(301) - 150.0)
    field = from_array(hill(2 * i, 2 * j)[0].astype(np.float32), 2.0)
    x, y = places_in(field, 4000, inset=0.05)
    z, p, q, r, s, t = hill(x, y)
    found = made(field, x, y, level)
    g2 = p * p + q * q
    w = 1 + g2
    np.testing.assert_allclose(found["height"], z, atol=6e-3 * accuracy)
    np.testing.assert_allclose(found["slope"], np.arctan(np.sqrt(g2)), atol=2e-4 * accuracy)
    mean = -((1 + q * q) * r - 2 * p * q * s + (1 + p * p) * t) / (2 * w**1.5)
    np.testing.assert_allclose(found["mean_curvature"], mean, atol=2e-5 * accuracy)
    steep = g2 > 0.05
    profile = -(r * p * p + 2 * s * p * q + t * q * q) / (g2 * w**1.5)
    plan = -(r * q * q - 2 * s * p * q + t * p * p) / g2**1.5
    np.testing.assert_allclose(found["profile_curvature"][steep], profile[steep], atol=4e-5 * accuracy)
    np.testing.assert_allclose(found["plan_curvature"][steep], plan[steep], atol=1e-4 * accuracy)
    downhill = np.stack([-p, -q], 1) / np.sqrt(g2)[:, None]
    np.testing.assert_allclose(found["aspect"][steep], downhill[steep], atol=1e-3 * accuracy)


def test_jets_at_samples_equal_the_spline_by_sums():
    """Weights 1/6, 4/6, 1/6 of heights; differences of neighbours; of rows alike: all in float64."""
    z = raster(70, 50).astype(np.float64)
    field = from_array(z.astype(np.float32), 5.0)

    def mean(a):
        return (a[:-2] + 4 * a[1:-1] + a[2:]) / 6

    def step(a):
        return (a[2:] - a[:-2]) / 10.0

    def bend(a):
        return (a[2:] - 2 * a[1:-1] + a[:-2]) / 25.0

    def both(along_y, along_x):
        return along_x(along_y(z).T).T.ravel()

    west, south, _, _ = field.lattice.rectangle()
    x, y = np.meshgrid(west + 5.0 * np.arange(1, 69), south + 5.0 * np.arange(1, 49))
    found = made(field, x, y)
    p, q = both(mean, step), both(step, mean)
    np.testing.assert_allclose(found["height"], both(mean, mean), atol=1e-4)
    np.testing.assert_allclose(found["slope"], np.arctan(np.hypot(p, q)), atol=1e-6)
    w = (1 + p * p + q * q) ** 1.5
    mixed = 2 * p * q * both(step, step)
    curvature = -((1 + q * q) * both(mean, bend) - mixed + (1 + p * p) * both(bend, mean)) / (2 * w)
    np.testing.assert_allclose(found["mean_curvature"], curvature, atol=1e-6)


def test_second_derivatives_are_continuous():
    field = from_array(raster(64, 64), 10.0)
    west, south, _, _ = field.lattice.rectangle()
    edge = west + 10.0 * np.arange(5, 50)
    a, b = (made(field, edge + d, np.full(45, south + 133.0), 0.5)["mean_curvature"] for d in (-1e-3, 1e-3))
    assert abs(a - b).max() < 2e-3 * abs(a).max()
    a, b = (made(field, edge, np.full(45, south + 133.0), level)["slope"] for level in (1.0 - 2**-20, 1.0 + 2**-20))
    assert abs(a - b).max() < 1e-5


def fields():
    """Yield 512 samples that do not fit a lattice, a raster with holes, 16-bit codes, a bicubic and a very high
    surface."""
    yield "512", from_array(raster(512, 512), 3.0), {}
    holes = raster(1000, 700)
    holes[200:300, 300:500] = holes[:3, :] = np.nan
    yield "holes", from_array(holes, 3.0, holes=True), {}
    numbers, steps = (raster(200, 120) * 8 + 4000).astype(np.uint16), Steps(0, 0.125, -500.0)
    coded = from_array(steps.heights(numbers), 3.0).with_raster(samples=numbers, steps=steps)
    yield "coded", coded, {"vertical_scale": -3.5, "vertical_offset": 100.0}
    yield "bicubic", interpolated(from_array(raster(130, 97), 3.0), "bicubic"), {"vertical_scale": 0.0}
    high = (raster(97, 97) * 5e27).astype(np.float32)
    yield "high", from_array(high, 1e-3), {}


@pytest.mark.parametrize(("field", "scale"), [(f, s) for _, f, s in fields()], ids=[name for name, _, _ in fields()])
def test_values_are_finite_and_the_same_on_all_threads(field, scale):
    surface = Terrain(field).update(Criterion(error_px=0, error_m=float(np.ptp(field.heights())) / 50), **scale).surface
    level = np.random.default_rng(3).integers(0, 90, len(surface.positions)).astype(np.float32) / 8
    one, two = (SamplePoints(field, surface.positions, level, *scale.values(), threads=threads) for threads in (1, 3))
    first, second = make(one, ALL, {}), make(two, ALL, {})
    for name, values in first.items():
        assert np.isfinite(values).all(), name
        assert values.tobytes() == second[name].tobytes(), name
    lengths = np.sqrt((first["detail_normal"].astype(np.float64) ** 2).sum(1))
    np.testing.assert_allclose(lengths, 1, atol=1e-6)
    turned = np.hypot(*first["aspect"].T.astype(np.float64))
    assert np.isin(np.rint(turned * 1e5), [0, 1e5]).all()


def test_values_that_are_not_requested_are_not_computed():
    field = from_array(raster(64, 64), 10.0)
    x, y = places_in(field, 100)
    everything = made(field, x, y, 0.625)
    positions = np.stack([x, y, 0 * x], 1).astype(np.float32)
    for name in OUTPUTS:
        alone = make(SamplePoints(field, positions, np.full(100, 0.625, np.float32)), {name: {}}, {})
        assert alone.keys() == {name} and alone[name].tobytes() == everything[name].tobytes()
