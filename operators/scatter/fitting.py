# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of a scatter that follow from the size of its land and of the objects in its collection."""

import math

import numpy as np
from mathutils import Matrix

from ...cbt_terrain.field.heightfield import HeightField
from ..importing.imported import imported_of
from .habitats import has_habitat

# Spacings in a terrain's longer side before a collection is chosen: 40,000 points on a square one, twice as many at
# most, as spacings have one digit. Ground with gaps or holes gets as many in all.
PER_SIDE = 200
# Points on a whole land at full density, at most: 1.5 GB of instances where no camera limits them.
MAX_ON_LAND = 1_000_000
# Distance in spacings up to which density is full: for cones, for a collection, and for a collection with rules. 100
# are 12,800 conifers in a view of the island from its coast.
FULL_OF_CONES, FULL_OF_OBJECTS, FULL_WITH_RULES = 200, 100, 140
# Approximate fraction of the ground that rules leave: with rules, half the spacing gives no more objects.
SHARE_BY_RULES = 0.25
REACH_HEIGHTS = 2  # the setting Reach in heights of an object: the object and its shadow
WITHOUT_EXTENT = ("EMPTY", "LIGHT", "CAMERA", "SPEAKER", "LIGHT_PROBE")
NAMES = ("spacing", "full_until", "size", "margin_m")  # in the order of `fitted`


def size_of(collection) -> tuple[float, float]:
    """Return the largest width in plan and the largest height of a collection's instances, metres of the world.

    An object is an instance, and so is a child collection with all that is in it. (0, 0) if nothing has an extent.
    """
    boxes = [_corners([obj]) for obj in collection.objects]
    boxes += [_corners(child.all_objects) for child in collection.children]
    extents = [np.ptp(corners, axis=0) for corners in boxes if len(corners)]
    if not extents:
        return 0.0, 0.0
    x, y, z = np.max(extents, axis=0).tolist()
    return max(x, y), z


def _corners(objects) -> np.ndarray:
    """Return the corners of the bounding boxes of objects that have one, float64 [n, 3], in the world."""
    found = [np.empty((0, 3))]
    for obj in objects:
        if obj.type not in WITHOUT_EXTENT:
            matrix = np.array(_to_world(obj), np.float64)
            found.append(np.array(obj.bound_box, np.float64) @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(found)


def _to_world(obj) -> Matrix:
    """Return the matrix of an object to the world, without constraints.

    `matrix_world` is not up to date in a collection that is excluded from the view layer.
    """
    if obj.parent is None:
        return obj.matrix_basis
    return _to_world(obj.parent) @ obj.matrix_parent_inverse @ obj.matrix_basis


def scale_of(terrain) -> float:
    """Return the length in the world of a horizontal metre of a terrain's own space, the mean of x and y."""
    x, y, _ = terrain.matrix_world.to_scale()
    return math.sqrt(abs(x * y)) or 1.0


def first_spacing(field: HeightField) -> float:
    """Return the spacing of a scatter before a collection is chosen, metres of the terrain's space."""
    from ...cbt_terrain.field.known_ground import ground_fraction

    west, south, east, north = field.lattice.rectangle()
    return rounded(max(east - west, north - south) * math.sqrt(ground_fraction(field)) / PER_SIDE)


def count_on_land(terrain, spacing: float) -> int | None:
    """Return the number of points at full density on all the land of a terrain, without rules; None without a store.

    spacing: metres of the terrain's space. Holes and wide gaps do not count.
    """
    found = imported_of(terrain.adaptive_terrain)
    return None if found is None else round(found.ground_m2 / spacing**2)


def fit(obj) -> None:
    """Set spacing and distances of a scatter to suit the size of its collection's objects.

    Points are as far apart as the objects are wide, and further on land that would get more than MAX_ON_LAND of them.
    A number that the user has changed since it was last fitted stays. Without a collection that has an extent, or
    without a terrain, nothing changes.
    """
    settings, terrain = obj.adaptive_scatter, obj.parent
    width, height = (0.0, 0.0) if settings.collection is None else size_of(settings.collection)
    if width <= 0.0 or terrain is None:
        return
    scale, raster = scale_of(terrain), imported_of(terrain.adaptive_terrain)
    is_ruled = has_habitat(settings.where)
    # Rules leave about SHARE_BY_RULES of the points, so these may be closer together. full: distance from the camera,
    # in spacings, from which points are left out.
    factor, full = (math.sqrt(SHARE_BY_RULES), FULL_WITH_RULES) if is_ruled else (1.0, FULL_OF_OBJECTS)
    # smallest: spacing at which all the land has MAX_ON_LAND points
    smallest = 0.0 if raster is None else scale * math.sqrt(raster.ground_m2 / MAX_ON_LAND)
    spacing = rounded(max(width, factor * smallest), digits=2, toward=math.ceil)
    # The setting of the spacing counts in the terrain's own metres, distances from the camera in those of the world.
    # reach: how far an object and its shadow extend from its point, metres of the world
    put_numbers(settings, spacing / scale, full_until=full * spacing, reach=REACH_HEIGHTS * max(width, height))


def put_numbers(settings, spacing: float, full_until: float, reach: float, first: bool = False) -> None:
    """Set the fitted numbers of a scatter and remember them, to tell later which ones the user has changed.

    spacing: metres of the terrain's space. full_until: distance from the camera up to which all points exist; reach:
    how far objects and their shadows extend from their points; both in metres of the world. first: set all, otherwise
    only those that the user has not changed. The size is set to 1.
    """
    for number, (name, value) in enumerate(zip(NAMES, (spacing, full_until, 1.0, reach), strict=True)):
        if first or getattr(settings, name) == settings.fitted[number]:
            setattr(settings, name, value)
            settings.fitted[number] = getattr(settings, name)


def rounded(value: float, digits: int = 1, toward=round) -> float:
    """Round a positive number to `digits` significant digits. toward: `round`, or `math.ceil` to round up."""
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return toward(value / unit) * unit
