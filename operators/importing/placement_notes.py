# SPDX-License-Identifier: GPL-3.0-or-later
"""Notes after an import: neighbouring terrains, the scene's units, how a picture of the same raster fits on it."""

import math
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import shown
from ...cbt_terrain.field.georeference import degree_lengths, from_crs, to_crs
from ...cbt_terrain.field.lands import LANDS
from ..bridge.scene_origin import CRS_X, CRS_Y, SRID
from ..scatter.request import scatters_of
from .imported import Imported, imported_of

FOOT = 0.3048
# Cells by which the distance of two rasters may be off: degrees of other ellipsoids.
MAX_GAP_ERROR = 0.25


def unit_note(scene, settings) -> str:
    """Return a note if the scene's units show the size of an imported file wrongly, "" otherwise.

    A metre of the file is one unit of Blender. settings: the terrain's.
    """
    units, scale = scene.unit_settings, scene.unit_settings.scale_length
    if settings.source != "FILE" or units.system == "NONE" or abs(scale - 1.0) < 1e-6:
        return ""
    return (
        f"The scene's Unit Scale is {scale:.6g}, so Blender shows a metre of this terrain as {scale:.6g} m: set it to "
        f"1 under Scene > Units, or scale the terrain by {1.0 / scale:.6g}."
    )


def neighbour_notes(obj, others) -> list[str]:
    """Return notes about other terrains of the same coordinate system: a wrong distance, an open seam between both.

    An import may leave the object where it is, so two neighbouring rasters can have equal locations. Only this wrong
    distance is noted, and for one other terrain only. A seam is an open cell, or a shared line of samples. others:
    terrains, `obj` may be among them.
    """
    notes, has_noted_distance = [], False
    for other in others:
        if other == obj or not obj.get(SRID) or other.get(SRID) != obj[SRID]:
            continue
        crs_offset = [obj[name] - other[name] for name in (CRS_X, CRS_Y)]
        locations = zip(obj.matrix_world.translation, other.matrix_world.translation, strict=True)
        offset = [a - b for a, b in locations][:2]  # metres in the scene
        if any(crs_offset) and not any(offset) and not has_noted_distance:
            has_noted_distance = True
            east, north = (f"{value:.10g}" for value in crs_offset)
            notes.append(
                f"{shown(obj.name)} stands where {shown(other.name)} stands, but in {shown(obj[SRID], 40)} it is "
                f"{east} further east and {north} further north, in the system's units: change its location by that "
                "length in metres."
            )
        rasters = [imported_of(item.adaptive_terrain) for item in (other, obj)]
        if None not in rasters and (gap := cells_between(*rasters)) is not None:
            both = f"{shown(other.name)} and {shown(obj.name)}"
            files = " ".join(shown(Path(raster.settings.get("source", "")).name) or "FILE" for raster in rasters)
            problem = (
                f"The cells of {both} meet edge to edge, but a mesh ends at the middles of its outermost samples, so "
                "one cell between them stays open"
                if gap == 1
                else f"{both} share a line of samples, where their meshes may be apart by up to the sum of both errors"
            )
            notes.append(
                f"{problem}: import both as one terrain (press Add Tiles on one of them, or adaptive-terrain import "
                f"{files})."
            )
    return notes


def cells_between(first: Imported, second: Imported) -> int | None:
    """Return the cells between the outermost samples of two rasters that touch along a side; None if they do not.

    1: their cells meet edge to edge. 0: they share a line of samples. Both are of the same coordinate system, whose
    unit a store does not record, so metres, feet and degrees are tried.
    """
    latitude = (first.origin[1] + second.origin[1]) / 2
    units = [(1.0, 1.0), (FOOT, FOOT)]
    if abs(latitude) < 90.0 and max(abs(first.origin[0]), abs(second.origin[0])) <= 360.0:
        units.append(degree_lengths(latitude))
    gaps = [_gap(first, second, metres) for metres in units]
    return next((cells for cells in (1, 0) if any(abs(gap - cells) < MAX_GAP_ERROR for gap in gaps)), None)


def _gap(first: Imported, second: Imported, metres: tuple[float, float]) -> float:
    """Return the cells between the outermost samples of two rasters along the axis that separates them.

    Negative for rasters that overlap, infinite for those that are not side by side. Cells are the mean of both. metres:
    length of a unit of the coordinate system along x and y.
    """
    gaps = []
    for axis in (0, 1):
        distance = abs(second.origin[axis] - first.origin[axis]) * metres[axis]  # of the rasters' middles
        cell = (first.step_m[axis] + second.step_m[axis]) / 2
        gaps.append((distance - (first.extent_m[axis] + second.extent_m[axis]) / 2) / cell)
    # Side by side: they overlap along the other axis, where the gap is below 0 by more than rounding.
    return max(gaps) if min(gaps) < -MAX_GAP_ERROR else math.inf


def scatter_note(obj, before: Imported | None) -> str:
    """Return a note if an import has moved the points of a terrain's scatters; "" otherwise, or without any.

    Points belong to squares that are counted from the raster's corner in the south-west. before: facts of the earlier
    raster, None without one.
    """
    now = imported_of(obj.adaptive_terrain)
    if not scatters_of(obj) or before is None or now is None or None in (before.place, now.place):
        return ""
    corners = [  # infinite in another coordinate system, so that they differ
        to_crs(raster.place, -np.array([raster.extent_m]) / 2) if raster.crs == now.crs else np.full((1, 2), np.inf)
        for raster in (before, now)
    ]
    steps = from_crs(now.place, corners[0]) - from_crs(now.place, corners[1])
    if np.abs(steps).max() < MAX_GAP_ERROR * min(now.step_m):
        return ""
    return (
        "The raster's corner in the south-west has moved, and scatters count from there: their points stand at new "
        "places."
    )


def picture_note(imported: Imported | None) -> str:
    """Return how to put a picture with the raster's corners on the mesh; "" for a built-in land or a reprojected file.

    The mesh's UV is 0 and 1 at the middles of the outermost samples, half a cell inside those corners.
    """
    settings = imported.settings if imported is not None else {}
    if not settings or settings.get("source", "") in LANDS or settings.get("project"):
        return ""
    samples = [round(extent / step) + 1 for extent, step in zip(imported.extent_m, imported.step_m, strict=True)]
    location, scale = (", ".join(f"{value:.7g}" for value in values) for values in picture_mapping(samples))
    return (
        "A picture with the raster's corners (an orthophoto) is off by half a cell on the mesh's UV map: put a Mapping "
        f"node between UV and the picture, with Location {location} and Scale {scale}."
    )


def picture_mapping(samples) -> tuple[list[float], list[float]]:
    """Return location and scale along x and y that map the mesh's UV to a picture with the raster's corners.

    UV is 0 and 1 at the outermost samples, and a picture's outermost pixels have their centres half a pixel inside.
    samples: columns and rows of the raster.
    """
    return [0.5 / count for count in samples], [(count - 1) / count for count in samples]
