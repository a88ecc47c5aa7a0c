# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient occlusion by the ground within a radius."""

from collections.abc import Mapping

import numpy as np

from ..run import launch
from .attribute import AttributeDeclaration, Evaluate, Parameter, SamplePoints, Wanted
from .light import AZIMUTHS, azimuths

# A slope below any other: near ground counts below the horizontal, too.
ANY = -1e300


def visible_sky(points: SamplePoints, far: float, lowest: float) -> np.ndarray:
    """Return the visible fraction of the sky at points, weighted by the cosine, float32 [n], by rays from each point.

    Ground farther than `far` metres does not hide. All sky below the slope `lowest` is hidden, as if there were a
    horizon. Points count at the height of the raster's ground, without displacement. (Sweeps, as in sky.py, are faster,
    but they do not measure how far the ground that hides is.)
    """
    from ...kernels import wp
    from ...kernels.effects.light import sky_seen
    from .occluder import launch_at_points, occluder_of

    out = np.zeros(len(points), np.float32)
    directions = wp.array(azimuths(), dtype=wp.vec2d, device=launch.DEVICE)
    first_azimuth = 0
    inputs = [occluder_of(points), wp.float64(far), wp.float64(lowest), directions, first_azimuth, AZIMUTHS]
    launch_at_points(sky_seen, points, inputs, out, cost=2000.0)
    return out


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute ambient occlusion at points: 1 for open ground, less where ground within a radius hides the sky.

    wanted: {"ambient_occlusion": {"radius": metres}}. read: unused. Returns {"ambient_occlusion": float32 [n]}.
    """
    radius = float(wanted["ambient_occlusion"]["radius"])
    return {"ambient_occlusion": visible_sky(points, far=radius, lowest=ANY)}  # no slope hides the sky by itself


def example(evaluate: Evaluate) -> None:
    """Assert that a steep plane hides nothing of its half space, and that a high wall hides half of it at its foot.

    evaluate: returns an attribute at the samples of a raster, without the two outermost on each side.
    """
    east = np.arange(41, dtype=np.float32) * 2.0
    assert abs(evaluate("ambient_occlusion", np.tile(east, (41, 1)), step=2.0) - 1.0).max() < 1e-6
    wall = np.tile(np.where(east >= 40.0, np.float32(1e4), np.float32(0.0)), (41, 1))
    foot = evaluate("ambient_occlusion", wall, step=2.0, radius=20.0)[:, 17]  # 4 m before the wall
    assert 0.49 < foot.min() <= foot.max() < 0.51


OCCLUSION = AttributeDeclaration(
    name="ambient_occlusion",
    about="How open the surroundings of a point are, within a radius: 1 is open, 0 is closed in",
    unit="1",
    span=(0.0, 1.0),
    make=make,
    kernels=("effects.light", "effects.pyramid", "effects.sweep"),
    example=example,
    parameters=(Parameter("radius", 50.0, 0.01, 1e6, "m", "How far around a point the ground counts"),),
    scaled=False,
    halo="the radius",
    cost_ns=11000,
    source="Bavoil, Sainz and Dimitrov 2008 (horizons); Tevs, Ihrke and Seidel 2008 (max mipmap)",
)
