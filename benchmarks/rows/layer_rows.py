# SPDX-License-Identifier: GPL-3.0-or-later
"""What splat layers and the routing of water cost, each beside what it comes on top of."""

import math

import numpy as np

from ...cbt_terrain.effects import jet, splat, whole
from ...cbt_terrain.effects.effect import Places
from ...cbt_terrain.effects.flow import logarithms
from ...cbt_terrain.effects.splat_rules import MOST_LAYERS, Layer, Rule, reads
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.run import launch
from ..rig.measure import Row, alternate, stopwatch

VERTICES = 500_000  # of a million triangles
ROUTED = 1025  # samples a side


def layer_rows(rough: HeightField):
    """Twelve layers of height, slope and curvature, half of them with noise, for the vertices of a million triangles;
    the catchment areas of a raster."""
    places, layers = _places(rough), twelve_layers()
    wanted = {name: {"layers": layers} for name in splat.NAMES}
    read = jet.make(places, dict.fromkeys(reads(layers), {}), {})

    def splats() -> dict[str, float]:
        with stopwatch() as elapsed:
            splat.make(places, wanted, read)
        return {"total": elapsed[0]}

    def jets() -> float:
        with stopwatch() as elapsed:
            jet.make(places, dict.fromkeys(reads(layers), {}), {})
        return elapsed[0]

    timed = alternate(splats, jets)
    yield Row("splats", VERTICES, timed.ms["total"], "the heights, slopes and curvatures they read", timed.baseline_ms)

    heights = np.ascontiguousarray(rough.heights()[:ROUTED, :ROUTED])
    field = from_array(heights, rough.lattice.step_x)

    def route() -> dict[str, float]:
        whole.forget()
        with stopwatch() as elapsed:
            logarithms(field, 1.0, launch.default_threads())
        return {"total": elapsed[0]}

    def build() -> float:
        with stopwatch() as elapsed:
            from_array(heights, rough.lattice.step_x)
        return elapsed[0]

    timed = alternate(route, build)
    yield Row("flow", ROUTED * ROUTED, timed.ms["total"], "what an import makes of the raster", timed.baseline_ms)


def twelve_layers() -> tuple[Layer, ...]:
    """As rich as layers of a terrain may be."""
    made = [Layer("Ground")]
    for k in range(MOST_LAYERS - 1):
        low, steep = k // 3 / 4 - 0.02, math.radians(20 * (k % 3) - 6)
        rules = [Rule("relief", low, low + 0.35, 0.06), Rule("slope", steep, steep + math.radians(29), 0.15)]
        if k % 2:
            made.append(Layer(str(k), tuple(rules), noise_size=25.0 * (1 + k % 4), ragged=0.5, seed=k))
        else:
            made.append(Layer(str(k), (*rules, Rule("curvature", high=0.05, edge=0.05))))
    return tuple(made)


def _places(field: HeightField) -> Places:
    """Places in rows, as vertices of a mesh lie: near each other in memory where they are near each other."""
    west, south, east, north = field.lattice.rectangle()
    side = math.isqrt(VERTICES)
    x, y = np.meshgrid(np.linspace(west, east, side), np.linspace(south, north, side))
    at = np.stack([x, y, 0 * x], -1).reshape(-1, 3).astype(np.float32)
    return Places(field, at, np.full(len(at), 0.5, np.float32))
