# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of the ground's height and derivatives at a point: height, slope, aspect, curvatures and the normal.

One kernel computes all requested ones, since they share the derivatives. In the examples `evaluate` returns an
attribute at the samples of a raster, without the two outermost on each side.
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from ..run import launch
from ..run.buffers import flat, shared
from .attribute import AttributeDeclaration, Evaluate, SamplePoints, Wanted
from .decals import DECALS, tilt
from .pyramid import scaled_pyramid

KERNELS = ("effects.jet", "effects.pyramid")

SOURCE = "Uniform cubic B-spline over a [1 2 1] pyramid (Burt 1981)"
HORN = 'Horn 1981, "Hill shading and the reflectance map", section II; ' + SOURCE
EVANS = 'Evans 1980, "An integrated system of terrain analysis and slope mapping"; ' + SOURCE
# Attribute -> field of the kernel's Values, name of Warp's type of an element, name of the kernel's bit that requests
# the attribute, and numpy's shape of an element.
OUTPUTS = {
    "height": ("height", "float32", "HEIGHT", ()),
    "slope": ("slope", "float32", "SLOPE", ()),
    "aspect": ("aspect", "vec2f", "ASPECT", (2,)),
    "mean_curvature": ("mean_curvature", "float32", "MEAN_CURVATURE", ()),
    "profile_curvature": ("profile_curvature", "float32", "PROFILE_CURVATURE", ()),
    "plan_curvature": ("plan_curvature", "float32", "PLAN_CURVATURE", ()),
    "detail_normal": ("normal", "vec3f", "NORMAL", (3,)),
}


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute those of height, slope, aspect, curvatures and normals that `wanted` names, at points.

    They come from the heights' first and second derivatives at the scale of each point. wanted: parameters by name;
    only detail_normal has one, decals. read: unused, they read no attribute. Returns by name float32 [n], [n, 2] for
    aspect, or [n, 3] for detail_normal.
    """
    from ...kernels import wp
    from ...kernels.effects import jet as kernels
    from .finer_pyramid import finer_heights

    values, arrays, bits = kernels.Values(), {}, 0
    for name in wanted:
        # The field of `values`, its Warp type, the bit in `wanted`, and the shape of a point's value.
        field, dtype, bit, shape = OUTPUTS[name]
        arrays[name] = np.empty((len(points), *shape), np.float32)
        setattr(values, field, shared(arrays[name], getattr(wp, dtype)))
        bits += int(getattr(kernels, bit))
    values.wanted = bits
    heights = scaled_pyramid(points.field.raster, points.vertical_scale, points.vertical_offset, points.threads)
    finer = finer_heights(points.field.raster, points.threads)
    inputs = [heights, finer, shared(points.positions, wp.vec3f), flat(points.level, wp.float32), values]
    launch.spread(kernels.from_jets, len(points), inputs, step="jets", threads=points.threads, cost=6)
    if "detail_normal" in arrays:
        tilt(arrays["detail_normal"], wanted["detail_normal"].get("decals", ()), points)
    return arrays


_declared = partial(AttributeDeclaration, make=make, kernels=KERNELS, halo="2 samples of the level")


def height_example(evaluate: Evaluate) -> None:
    """Assert that the mean around a point of a plane is its height."""
    heights = np.add.outer(np.arange(17) * 3.0, np.arange(17) * 5.0)
    assert abs(evaluate("height", heights, step=10.0) - heights[2:-2, 2:-2]).max() < 1e-4


HEIGHT = _declared(
    name="height",
    about="Height of the ground with displacement, averaged over the smallest forms that are shown there",
    unit="m",
    example=height_example,
    cost_ns=50,
    source=SOURCE,
)


def slope_example(evaluate: Evaluate) -> None:
    """Assert that a plane that rises 1 m in sqrt(3) m has 30 degrees everywhere."""
    east = np.arange(17, dtype=np.float32) * 10.0
    slope = evaluate("slope", np.tile(east * np.float32(1 / math.sqrt(3)), (17, 1)), step=10.0)
    assert abs(slope - math.radians(30)).max() < 1e-5


SLOPE = _declared(
    name="slope",
    about="Angle of the ground: 0 is level, pi / 2 is upright",
    unit="rad",
    example=slope_example,
    span=(0.0, math.pi / 2),
    cost_ns=70,
    source=HORN,
)


def aspect_example(evaluate: Evaluate) -> None:
    """Assert that ground that falls to the east has a sine of 1. An angle would jump from 360 to 0 degrees."""
    aspect = evaluate("aspect", np.tile(np.arange(17) * -4.0, (17, 1)), step=10.0)
    assert abs(aspect - np.array([1.0, 0.0])).max() < 1e-6


ASPECT = _declared(
    name="aspect",
    about="Compass direction in which the ground falls, as its sine (to the east) and cosine (to the north); (0, 0) on "
    "level ground",
    unit="",
    example=aspect_example,
    width=2,
    span=(-1.0, 1.0),
    cost_ns=55,
    source=HORN,
)


def mean_curvature_example(evaluate: Evaluate) -> None:
    """Assert that a summit with a radius of 50 m has a curvature of 1 / 50 m, and a hollow the negative one."""
    across = np.arange(-8, 9) * 2.0
    summit = np.add.outer(across**2, across**2) / (-2 * 50.0)
    middle = 6, 6  # of the evaluated samples
    assert abs(evaluate("mean_curvature", summit, step=2.0)[middle] - 1 / 50.0) < 1e-6
    assert abs(evaluate("mean_curvature", -summit, step=2.0)[middle] + 1 / 50.0) < 1e-6


MEAN_CURVATURE = _declared(
    name="mean_curvature",
    about="How the ground bends: positive on summits and ridges, negative in hollows and channels",
    unit="1/m",
    example=mean_curvature_example,
    cost_ns=55,
    source='Shary 1995, "Land surface in gravity points classification"; ' + SOURCE,
)


def profile_curvature_example(evaluate: Evaluate) -> None:
    """Assert that a slope that steepens downhill, z = -k x^2 / 2, has the curvature k / (1 + (k x)^2)^(3/2)."""
    k, x = 0.02, 40.0 + np.arange(17) * 2.0
    heights = np.tile(-k * x**2 / 2, (17, 1))
    expected = k / (1 + (k * x[2:-2]) ** 2) ** 1.5
    assert abs(evaluate("profile_curvature", heights, step=2.0) - expected).max() < 1e-6
    assert abs(evaluate("profile_curvature", -heights, step=2.0) + expected).max() < 1e-6


PROFILE_CURVATURE = _declared(
    name="profile_curvature",
    about="How the slope changes downhill: positive where it gets steeper, negative at its foot, 0 on level ground",
    unit="1/m",
    example=profile_curvature_example,
    cost_ns=60,
    source=EVANS,
)


def plan_curvature_example(evaluate: Evaluate) -> None:
    """Assert that contour lines of a round hill, circles of radius r, have a curvature of 1 / r, of a hollow -1 / r."""
    across = np.arange(-8, 9) * 2.0
    hill = np.add.outer(across**2, across**2) / -100.0
    radius = np.sqrt(np.add.outer(across**2, across**2))[2:-2, 2:-2]
    away = radius > 0
    assert abs(evaluate("plan_curvature", hill, step=2.0)[away] - 1 / radius[away]).max() < 1e-5
    assert abs(evaluate("plan_curvature", -hill, step=2.0)[away] + 1 / radius[away]).max() < 1e-5


PLAN_CURVATURE = _declared(
    name="plan_curvature",
    about="How contour lines bend: positive on ridges, negative in valleys, 0 on level ground; at most 1 / the "
    "distance of samples at the scale",
    unit="1/m",
    example=plan_curvature_example,
    cost_ns=60,
    source=EVANS,
)


def normal_example(evaluate: Evaluate) -> None:
    """Assert that ground that rises to the east by 45 degrees faces west and up."""
    normal = evaluate("detail_normal", np.tile(np.arange(17) * 10.0, (17, 1)), step=10.0)
    assert abs(normal - np.array([-np.sqrt(0.5), 0, np.sqrt(0.5)])).max() < 1e-6


DETAIL_NORMAL = _declared(
    name="detail_normal",
    about="Direction in which the ground faces, in the terrain's own space: with displacement close to the camera, "
    "without it far away",
    unit="",
    example=normal_example,
    width=3,
    parameters=(DECALS,),
    span=(-1.0, 1.0),
    cost_ns=60,
    source='Olano and Baker 2010, "LEAN mapping", section 2 (the mean normal of a footprint); ' + SOURCE,
)


JETS = (HEIGHT, SLOPE, ASPECT, MEAN_CURVATURE, PROFILE_CURVATURE, PLAN_CURVATURE, DETAIL_NORMAL)
