# SPDX-License-Identifier: GPL-3.0-or-later
"""Time to bake a normal map, against the plainest way in numpy to a map of the same size."""

import tempfile
import zlib
from pathlib import Path

import numpy as np

from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.attributes.bake import bake
from ..rig import scenes
from ..rig.measure import BenchmarkRow, alternate, stopwatch

SAMPLES, TEXELS = 2049, 2048
REQUEST = (AttributeRequest("detail_normal", ("this benchmark",)),)


def maps_row() -> BenchmarkRow:
    """Measure the way from heights to a complete PNG file; the first run computes the height pyramid as well."""
    field = scenes.island_of(SAMPLES)
    heights, step = field.samples, field.lattice.step_x

    def ours() -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder, stopwatch() as elapsed:
            bake(field, REQUEST, Path(folder) / "maps", [TEXELS])
        return {"total": elapsed[0]}

    def plain() -> float:
        with stopwatch() as elapsed:
            north, east = np.gradient(heights[:TEXELS, :TEXELS], step)
            normals = np.stack([-east, -north, np.ones_like(east)], -1)
            normals /= np.sqrt((normals * normals).sum(-1, keepdims=True))
            zlib.compress(np.rint((normals * 0.5 + 0.5) * 255).astype(np.uint8).tobytes(), 1)
        return elapsed[0]

    timed = alternate(ours, plain)
    figures = {"ns_texel": timed.ms["total"] * 1e6 / TEXELS**2}
    return BenchmarkRow("maps_normal", TEXELS**2, timed.ms["total"], "numpy", timed.baseline_ms, figures=figures)
