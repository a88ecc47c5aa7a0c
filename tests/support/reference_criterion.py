# SPDX-License-Identifier: GPL-3.0-or-later
"""How much too coarse a diamond is, written anew from its definition, in plain arithmetic."""

import math
from functools import cache

import numpy as np
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PERSPECTIVE, View
from diamond_entries import error_index
from fields import errors_of, ranges_of


def stored(field, x: float, y: float, depth: int) -> tuple[float, float, float]:
    """Error and heights of the diamond split at sample coordinates (x, y)."""
    low, high = (field.range_base + float(codes[int(y), int(x)]) * field.range_step for codes in _ranges(field))
    return float(_errors(field)[error_index(field.lattice, depth, int(x), int(y))]), low, high


_ranges, _errors = cache(ranges_of), cache(errors_of)  # of a field, for all its diamonds


def reference_pixels(field, view: View, x: float, y: float, depth: int, rounded: float) -> float:
    """Return the screen-space error in pixels at a diamond, by its definition in plain arithmetic."""
    lattice = field.lattice
    error, low, high = stored(field, x, y, depth)
    error = min(error + rounded, 4 * error)
    s = 2.0 ** (lattice.levels - (depth - 1) // 2 - 1)
    reach = 3 * s if depth % 2 else 2 * s
    eye = -np.linalg.solve(view.world_to_camera[:3, :3], view.world_to_camera[:3, 3])
    centre = np.array([(x - (lattice.width - 1) / 2) * lattice.step_x, (y - (lattice.height - 1) / 2) * lattice.step_y])
    corners = np.array(
        [
            [centre[0] + a * reach * lattice.step_x, centre[1] + b * reach * lattice.step_y, z]
            for a in (-1, 1)
            for b in (-1, 1)
            for z in (low, high)
        ]
    )
    up = view.world_to_camera[:3, 2]
    if view.kind == ORTHOGRAPHIC:
        return view.pixels_per_unit * error * max(np.linalg.norm(up[:2]), 0.5)
    nearest = np.clip(eye, corners.min(axis=0), corners.max(axis=0))
    distance = max(np.linalg.norm(nearest - eye), view.clip[0] / 2)
    if view.kind != PERSPECTIVE:
        upright = max(np.hypot(*(corner - eye)[:2]) for corner in corners) / distance
        return view.pixels_per_unit * error * min(max(upright, 0.5), 1.0) / distance
    secant = math.sqrt(1 + sum(max(map(abs, ends)) ** 2 for ends in view.bounds()))
    depth_m = max(0.0, -(corners @ view.world_to_camera[2, :3] + view.world_to_camera[2, 3]).max())
    depth_m = max(depth_m, distance / secant)
    in_camera = corners @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    moves = np.cross(up, in_camera)[:, :2]  # pixels' square: a metre of height moves a point at right angles to these
    slant = np.linalg.norm(np.abs(moves).max(axis=0)) / depth_m
    smallest, largest = slants_of(view)
    return view.pixels_per_unit * error * min(max(slant, smallest), largest) / depth_m


@cache
def slants_of(view: View) -> tuple[float, float]:
    """Return how far a metre of height looks, 1 m deep in the frame, at least and at most; half of it counts."""
    x, y = (np.linspace(*ends, 401) for ends in view.bounds())
    rays = np.stack([*np.broadcast_arrays(x[:, None], y, -1.0)], axis=-1)
    looks = np.linalg.norm(np.cross(view.world_to_camera[:3, 2], rays)[..., :2], axis=-1)
    smallest, largest = max(0.5, looks.min()), max(0.5, looks.max())
    return (largest if largest < 1.06 * smallest else smallest), largest


def correction(view: View, asked: float) -> float:
    """Return the correction of an error e at distance d, in a panorama seen 30 degrees off the vertical or steeper."""
    if view.kind == PERSPECTIVE:
        ahead = abs(view.world_to_camera[2, 2])
        return 1 + asked * ahead / (view.pixels_per_unit * slants_of(view)[0])
    if view.kind == ORTHOGRAPHIC:
        return 1.0
    radians = asked * view.radians_per_pixel
    steepness = np.radians(np.linspace(0, 30, 3001))  # by the law of sines
    part = (np.sin(min(radians, math.pi / 2)) / np.sin(np.minimum(radians + steepness, math.pi / 2))).min()
    return radians / (0.5 * part)
