# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient occlusion by the ground within a radius."""

from collections.abc import Mapping

import numpy as np

from ..run import launch
from .attribute import AttributeDeclaration, Evaluate, Parameter, SamplePoints, Wanted
from .light import AZIMUTHS, azimuths

# A slope below any other: near ground counts below the horizontal, too.
ANY = -1e300


def visible_sky(places: SamplePoints, far: float, lowest: float) -> np.ndarray:
    """Return the visible fraction of the sky at points, weighted by the cosine, float32 [n], by rays from each point.

    The sweeps of sky.py are faster, but know no distance of the ground that hides. Ground farther than `far` metres
    does not hide; all below the slope `lowest` is hidden, as if it were a horizon. Points count at
    the height of the raster's ground, without displacement.
    """
    from ...kernels import wp
    from ...kernels.effects.light import sky_seen
    from .occluder import launch_at_points, occluder_of

    out = np.zeros(len(places), np.float32)
    directions = wp.array(azimuths(), dtype=wp.vec2d, device=launch.DEVICE)
    first_azimuth = 0
    inputs = [occluder_of(places), wp.float64(far), wp.float64(lowest), directions, first_azimuth, AZIMUTHS]
    launch_at_points(sky_seen, places, inputs, out, cost=2000.0)
    return out


def make(places: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute ambient occlusion at points: 1 for open ground, less where ground within a radius hides the sky.

    wanted: {"ambient_occlusion": {"radius": metres}}. read: unused. Returns {"ambient_occlusion": float32 [n]}.
    """
    radius = float(wanted["ambient_occlusion"]["radius"])
    return {"ambient_occlusion": visible_sky(places, far=radius, lowest=ANY)}


def example(evaluate: Evaluate) -> None:
    """Assert that a steep plane hides nothing of its half space, and that a high wall hides half of it at its foot."""
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
