# SPDX-License-Identifier: GPL-3.0-or-later
"""Sun: the fraction of the sun's disc above the horizon."""

import math
from collections.abc import Mapping

import numpy as np

from .attribute import AttributeDeclaration, Evaluate, Parameter, SamplePoints, Wanted
from .light import strips_of, strongest

# The default sun, 45 degrees high in the south-west, with the width of the real one.
AFTERNOON = (-0.5, -0.5, 0.5 * math.sqrt(2.0), 0.00918)


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the fraction of the sun's disc that each point sees above the ground, 0 to 1; 0 without a sun.

    Points count at the height of the raster's ground, without displacement. wanted: {"sun": {"suns": lights of the
    scene}}, of which the strongest counts. read: unused. Returns {"sun": float32 [n]}. Raises TerrainError for an
    invalid sun.
    """
    from ...kernels import wp
    from ...kernels.effects.light import sun_seen
    from .occluder import launch_at_points, occluder_of

    sun = strongest(wanted["sun"]["suns"])
    disc = None if sun is None else strips_of(sun)  # None below the horizontal
    out = np.zeros(len(points), np.float32)
    if disc is not None:
        numbers = [wp.float64(disc[name]) for name in ("elevation", "radius", "low", "high")]
        inputs = [occluder_of(points), *numbers, disc["strips"]]
        launch_at_points(sun_seen, points, inputs, out, cost=300.0)
    return {"sun": out}


def example(evaluate: Evaluate) -> None:
    """Assert that a wall of 20 m under a sun 45 degrees high in the east casts a shadow of 20 m to the west.

    evaluate: returns an attribute at the samples of a raster, without the two outermost on each side.
    """
    east = np.arange(41, dtype=np.float32) * 2.0
    wall = np.tile(np.where(east >= 50.0, np.float32(20.0), np.float32(0.0)), (41, 1))
    lit = evaluate("sun", wall, step=2.0, suns=((1.0, 0.0, 1.0, 0.00918),))
    assert (lit[:, :13] == 1.0).all() and (lit[:, 14:23] == 0.0).all()


SUN = AttributeDeclaration(
    name="sun",
    about="Share of the sun's disc above the horizon, of the strongest sun lamp: 1 is in the sun, 0 is in the shadow",
    unit="1",
    span=(0.0, 1.0),
    make=make,
    kernels=("effects.light",),
    example=example,
    parameters=(
        Parameter(
            "suns",
            (AFTERNOON,),
            -math.inf,
            math.inf,
            "",
            "Rows of x, y, z towards a sun in the terrain's own space, the angle of its disc in radians, its strength; "
            "only the strongest counts",
        ),
    ),
    scaled=False,
    halo="the whole raster",
    cost_ns=2400,
    source="Tevs, Ihrke and Seidel 2008 (max mipmap); the disc in three upright strips",
)
