# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours on the terrain that show the error or the level of each triangle, with their legend."""

import math
from dataclasses import dataclass

import numpy as np

from ...cbt_terrain.mesh.attributes import CORNER, FACE, Attribute
from ..bridge.writer import COLOUR_ATTRIBUTE
from ..terrain.properties import ERROR_OVERLAY
from ..text.translations import phrase

# Nine stops of matplotlib's viridis, sRGB, which is perceptually uniform, also in grey and for the colour-blind.
VIRIDIS = np.array([
    (68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140),
    (40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37),
])  # fmt: skip
BEYOND = (255, 0, 60)  # a red that is not on the scale
STEPS = 256
LEGEND_LINES = 5
# Levels on the scale (coarser ones have the first colour), the largest level, and the factor that darkens odd levels.
SCALE_LEVELS, MAX_LEVEL, DARKER = 16, 63, 0.78

Legend = list[tuple[str, tuple[float, float, float]]]


@dataclass(frozen=True)
class Overlay:
    """An overlay.

    Attributes:
        attributes: colours of the corners and values of the faces, by name.
        legend: text and sRGB colour (0 .. 1) of each line, from the smallest value to the largest.
    """

    attributes: dict[str, Attribute]
    legend: Legend


def make_overlay(field, request, surface) -> Overlay:
    """Return the overlay that `request` asks for, for the triangles of `surface`. Any thread may call it.

    field: height field of the terrain. request: its Request, with views and error criteria. surface: the mesh, with the
    level of each triangle.
    """
    if request.overlay == ERROR_OVERLAY:
        return _color_errors(field, request, surface)
    return _color_levels(field.lattice, surface.level)


def scale_colours(fractions: np.ndarray) -> np.ndarray:
    """Return sRGB colours (0 .. 1, float64 [n, 3]) of fractions [n] of the scale, and BEYOND above 1."""
    return _scale_table()[_table_rows(fractions)]


def _color_errors(field, request, surface) -> Overlay:
    """Return the overlay of errors: colours from 0 to the error criterion, or to the largest error without one.

    Errors are pixels if the request has views, else metres.
    """
    from ...cbt_terrain.accuracy.measure import triangle_errors

    unit, criterion = ("px", request.criterion.error_px) if request.views else ("m", request.criterion.error_m)
    heights = request.vertical_scale, request.vertical_offset
    errors = triangle_errors(field, surface, request.views, request.placement, *heights)
    largest = float(errors.max(initial=0.0))
    scale = criterion or largest or 1.0
    fractions = np.linspace(0.0, 1.0, LEGEND_LINES)
    texts = [f"{scale * fraction:.3g} {unit}" for fraction in fractions]
    if largest > scale:
        fractions = np.append(fractions, math.inf)
        texts.append(phrase("Above the criterion, up to {} {}", f"{largest:.3g}", unit))
    rows = _table_rows(errors / np.float32(scale))
    attributes = {f"error_{unit}": Attribute(errors, FACE, unit)} | _corner_colours(_scale_table(), rows)
    return Overlay(attributes, _make_legend(texts, scale_colours(fractions)))


def _color_levels(lattice, level: np.ndarray) -> Overlay:
    """Return the overlay of levels. level: int [triangles], bisections of each. lattice: the height field's grid.

    Triangles of a cell's size, level lattice.cell_depth, end the scale and finer ones are beyond it, in every frame.
    Odd levels are darker, which separates neighbours. The legend has LEGEND_LINES of the levels at most, evenly spaced.
    """
    all_levels = np.arange(MAX_LEVEL + 1)
    span = max(1, min(SCALE_LEVELS, lattice.cell_depth - 1))  # levels on the scale
    colours = scale_colours(1.0 + (all_levels - lattice.cell_depth) / span)
    colours[1::2] *= DARKER
    listed = np.unique(level)
    if len(listed):
        listed = np.unique(listed[np.linspace(0, len(listed) - 1, LEGEND_LINES).round().astype(int)])
    texts = [phrase("Level {}: edges of {} m", n, f"{_shortest_edge_m(lattice, n):.3g}") for n in listed.tolist()]
    return Overlay(_corner_colours(colours, level), _make_legend(texts, colours[listed]))


def _shortest_edge_m(lattice, level: int) -> float:
    """Return the shortest horizontal edge of a triangle of this level in metres.

    Two more bisections halve all edges. Triangles of odd levels are halves of a square; those of even levels are
    quarters, with half of its diagonal as an edge. The squares of levels 1 and 2 have 2**lattice.levels cells a side.
    """
    x, y = (step * 2.0 ** (lattice.levels - (level - 1) // 2) for step in (lattice.step_x, lattice.step_y))
    return min(x, y) if level % 2 else min(x, y, math.hypot(x, y) / 2)


def _corner_colours(table: np.ndarray, rows: np.ndarray) -> dict[str, Attribute]:
    """Return corner colours, since Blender shows no face colours.

    table: sRGB colours [n, 3]. rows: for each triangle, its row of `table`. They are floats: `foreach_set` takes 5
    ms per million triangles for floats and 107 ms for bytes.
    """
    linear = np.ones((len(table), 4), np.float32)
    linear[:, :3] = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    return {COLOUR_ATTRIBUTE: Attribute(np.repeat(linear[rows], 3, axis=0), CORNER)}


def _scale_table() -> np.ndarray:
    """Return the colours of the scale in sRGB, with BEYOND as its last row, float64 [STEPS + 1, 3]."""
    fractions, stops = np.linspace(0.0, 1.0, STEPS), np.linspace(0.0, 1.0, len(VIRIDIS))
    scale = [np.interp(fractions, stops, channel) for channel in VIRIDIS.T]
    return np.vstack([np.stack(scale, -1), BEYOND]) / 255.0


def _table_rows(fractions: np.ndarray) -> np.ndarray:
    """Return the rows of the table of colours for fractions of the scale, int16 [n]; above 1 the last row."""
    rows = np.rint(np.clip(fractions, 0.0, 1.0) * (STEPS - 1)).astype(np.int16)
    rows[fractions > 1.0] = STEPS
    return rows


def _make_legend(texts: list[str], colours: np.ndarray) -> Legend:
    """Return the legend of texts and sRGB colours, float64 [n, 3]."""
    return list(zip(texts, map(tuple, colours.tolist()), strict=True))
