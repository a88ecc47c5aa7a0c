# SPDX-License-Identifier: GPL-3.0-or-later
"""What a detail below the raster's cells costs: triangles, and the displacement of a vertex."""

import numpy as np

from ...cbt_terrain.ask.view import View
from ...cbt_terrain.field.detail import Detail
from ...cbt_terrain.field.heightfield import HeightField, with_detail
from ...cbt_terrain.field.island import SIDE
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.measure import Row, alternate

AMPLITUDE = 0.05  # metres
# So low that a mesh for it has no more triangles than one without.
UNSEEN = 1e-5


def from_air_row() -> Row:
    """Of the built-in island at 1 px, as the other rows, seen from over its rim."""
    return _triangles("detail_from_air", scenes.built_in_island(), _from_air())


def from_ground_row() -> Row:
    """Seen from two metres above its ground."""
    field = scenes.built_in_island()
    last = len(field.samples) - 1
    eye = np.array([0.05, -0.1, 0.0]) * SIDE
    eye[2] = field.samples[round(0.4 * last), round(0.55 * last)] + 2.0
    return _triangles("detail_from_ground", field, View.look(eye, (0.0, 0.0, 0.1 * SIDE), clip=(0.1, 1e6)))


def _from_air() -> View:
    return View.look(scenes.eye_over(0, SIDE), (0, 0, 0), clip=(0.1, 1e6))


def _triangles(name: str, field: HeightField, view: View) -> Row:
    plain, detailed = (
        Terrain(surface).update(scenes.errors(1.0), [view])
        for surface in (field, with_detail(field, Detail(AMPLITUDE)))
    )
    row = Row(name, plain.triangles, detailed.ms["total"], "triangles without", plain.ms["total"])
    row.ratio, row.figures = detailed.triangles / plain.triangles, {"triangles": detailed.triangles}
    return row


def displacement_row() -> Row:
    """All vertices anew, on one thread: the camera comes back from where it has seen nothing of it."""
    field, view = scenes.built_in_island(), _from_air()
    away = View.look((0.0, 0.0, 1e3 * SIDE), (0.0, 0.0, 0.0))
    surfaces = field, with_detail(field, Detail(UNSEEN))
    plain, detailed = (Terrain(surface, 1) for surface in surfaces)
    vertices = {}

    def displaced(terrain: Terrain) -> float:
        terrain.update(scenes.errors(1.0), [away])
        update = terrain.update(scenes.errors(1.0), [view])
        vertices[terrain] = len(update.surface.positions)
        return update.ms["displace"]

    timed = alternate(lambda: {"total": displaced(detailed)}, lambda: displaced(plain))
    ms, baseline = timed.ms["total"], timed.baseline_ms
    ns = 1e6 * (ms / vertices[detailed] - baseline / vertices[plain]) / len(surfaces[1].parts)
    return Row("detail_displace", vertices[plain], ms, "displace", baseline, figures={"ns_octave": ns})
