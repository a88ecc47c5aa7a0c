# SPDX-License-Identifier: GPL-3.0-or-later
"""The place of a terrain in a scene whose origin has coordinates: rasters of one area fit together.

A terrain's anchor is the point of its raster that is the origin of its object: metres east and north of the raster's
middle. `Imported.place` is the affine map from metres about the middle to the coordinate system.
"""

import math
from contextlib import suppress

import numpy as np
from bpy.app.handlers import persistent
from mathutils import Vector

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field.georeference import Place, from_crs, to_crs
from ...cbt_terrain.field.store import changed_ns
from ...cbt_terrain.importing.placing import reproject_point
from .. import jobs
from ..bridge.evaluated import anchor_of
from ..bridge.scene_origin import (
    CRS_X,
    CRS_Y,
    SRID,
    WGS84,
    SceneOrigin,
    claim_origin,
    is_claimed,
    is_in_degrees,
    origin_of,
    remove_origin,
    set_origin,
    unit_lengths,
)
from ..bridge.scene_paths import absolute_path
from ..ground.shifting import keep_children, shift_location
from ..scatter.request import CORNER
from ..session import session
from .imported import LONGEST_CRS, Imported, imported_of, tag_object

SAME = 1e-6  # relative difference of lengths, and radians, that count as equal
MOVED = 1e-3  # of a sample's step: a raster whose middle has moved by more is another one
_stray: set[int] = set()  # by session_uid: terrains that had another raster than their place before an Undo, too


def follows_coordinates(obj, scene, before: Imported | None) -> bool:
    """Return whether an import may move a terrain: it is at its coordinates, or was just added and not moved since.

    A terrain with a parent is not moved. A scene without an origin first gets that of the terrain as it was imported
    before. before: facts of the terrain's last import, None for the first.
    """
    if obj.parent is not None:
        return False
    if before is None:
        return not any(obj.location[:2]) and _is_plain(obj)
    if origin_of(scene) is None:
        place_terrain(obj, scene, before)
    place = None
    with suppress(TerrainError):  # a system that cannot be converted
        place = _location_of(obj, origin_of(scene), before)
    return place is not None and all(
        abs(a - b) <= SAME * (1.0 + abs(b)) for a, b in zip(obj.location[:2], place, strict=True)
    )


def keep_anchor_inside(obj, imported: Imported | None) -> None:
    """Make the raster's middle the origin of a terrain whose anchor is outside of its new raster.

    imported: facts of that raster; with None, any anchor is outside.
    """
    half = (0.0, 0.0) if imported is None else (length / 2 for length in imported.extent_m)
    if any(abs(offset) > border for offset, border in zip(anchor_of(obj), half, strict=True)):
        obj.adaptive_terrain.anchor = (0.0, 0.0)


def origin_shift(obj, before: Imported | None, imported: Imported | None, anchor: tuple[float, float]) -> np.ndarray:
    """Return how far a new raster moves the origin of a terrain's object: float64 [2], metres in its former space.

    It is 0 for rasters whose extents do not overlap or that have no common system. before: facts of the earlier raster,
    None without one. imported: of the new one. anchor: of the terrain before.
    """
    if not _overlap(before, imported):
        return np.zeros(2)
    (new_anchor,) = from_crs(before.place, to_crs(imported.place, np.array([anchor_of(obj)])))
    return new_anchor - anchor  # metres in the earlier raster


def _overlap(before: Imported | None, imported: Imported | None) -> bool:
    """Return whether two rasters have a common system and their extents overlap; False without one of them."""
    if before is None or imported is None or before.crs != imported.crs or None in (before.place, imported.place):
        return False
    middle = from_crs(before.place, to_crs(imported.place, np.zeros((1, 2))))[0]  # metres in the earlier raster
    return bool((np.abs(middle) < (np.array(before.extent_m) + imported.extent_m) / 2).all())


def keep_scatter_corner(obj, before: Imported | None, imported: Imported | None) -> bool:
    """Note the point from which the scatters of a terrain count, so that a larger raster does not move their points.

    It is the south-western corner of the terrain's first raster with coordinates, until one is imported that does not
    overlap with the one before. Return whether the point has stayed. before: facts of the earlier raster, None without
    one. imported: of the new one.
    """
    stays = _overlap(before, imported) and bool(imported.crs)
    if stays and CORNER in obj:
        return True
    first = before if stays else imported
    obj.pop(CORNER, None)
    if first is not None and first.crs and first.place is not None:
        obj[CORNER] = to_crs(first.place, np.array([first.extent_m]) / -2)[0].tolist()
    return stays


def keep_ground(obj, by: np.ndarray, is_placed: bool) -> None:
    """Let the ground and the children of a terrain stay in the world although its origin has moved in its raster.

    by: result of `origin_shift`, metres. is_placed: whether the object itself was moved to its coordinates already.
    """
    if np.abs(by).max() <= SAME:
        return
    if not is_placed:
        basis = np.array(obj.matrix_basis, np.float64)[:3, :2]
        shifted: set[int] = set()  # animation curves that are shifted already
        shift_location(obj, Vector((basis @ by).tolist()), shifted)
    keep_children(obj, by)


def _move_of_raster(obj) -> np.ndarray | None:
    """Return the middle of the raster for which a terrain was placed, float64 [2] metres in its present raster.

    Its custom properties have the coordinates of that middle, and come back with Undo or with a file that was not saved
    after an import. The files of the store are those of the last import. None if the middle is that of the present
    raster, if that raster does not reach as far, or if there are no coordinates.
    """
    imported = imported_of(obj.adaptive_terrain)
    middle = obj.get(CRS_X), obj.get(CRS_Y)
    if imported is None or not imported.crs or imported.place is None:
        return None
    if not all(isinstance(c, int | float) for c in middle) or obj.get(SRID) != shown(imported.crs, LONGEST_CRS):
        return None
    (by,) = from_crs(imported.place, np.array([middle]))
    is_same, is_far = np.abs(by) <= MOVED * np.array(imported.step_m), np.abs(by) >= imported.extent_m
    return None if is_same.all() or is_far.any() or not np.isfinite(by).all() else by


def follow_raster(obj) -> bool:
    """Move a terrain whose store has another raster than its place; return whether it moved.

    The ground stays in the world.
    """
    by = _move_of_raster(obj)
    if by is not None:
        anchor = anchor_of(obj)
        keep_anchor_inside(obj, imported_of(obj.adaptive_terrain))
        keep_ground(obj, np.subtract(anchor_of(obj), anchor) - by, is_placed=False)
        obj.adaptive_terrain.frozen = ""  # triangles of the earlier raster
        tag_object(obj)
    return by is not None


def follow_replaced_store(obj) -> bool:
    """Move a terrain if another program has replaced its store since the last call; return whether it moved.

    It stays if it did not fit the store before, and during an import of this program, which places it at its end.
    """
    record, store = session.record_of(obj), absolute_path(obj.adaptive_terrain.store)
    now, before = (store, changed_ns(store)), record.placed_for
    if now == before or jobs.find(jobs.IMPORT, obj) is not None:
        return False
    has_moved = before is not None and before[0] == store and follow_raster(obj)
    record.placed_for = now if _move_of_raster(obj) is None else None
    return has_moved


def follow_store(obj) -> None:
    """Keep the ground of other terrains that use the store of `obj`, as copies do, after an import into that store."""
    folder = absolute_path(obj.adaptive_terrain.store)
    for other in session.all_terrains():
        if other != obj and absolute_path(other.adaptive_terrain.store) == folder:
            follow_raster(other)


@persistent
def on_load_post(_path, _unused=None) -> None:
    """Place terrains whose stores were imported after the file was saved."""
    for obj in session.all_terrains():
        follow_raster(obj)
        follow_replaced_store(obj)  # notes which store this is


@persistent
def on_undo_pre(_scene, _unused=None) -> None:
    """Note terrains that do not fit their stores already, as with a store that the user has chosen."""
    _stray.clear()
    _stray.update(obj.session_uid for obj in session.all_terrains() if _move_of_raster(obj) is not None)


@persistent
def on_undo(_scene, _unused=None) -> None:
    """Place terrains that Undo has moved back although the files of their stores stay."""
    for obj in session.all_terrains():
        if obj.session_uid not in _stray:
            follow_raster(obj)


def forget_left_origin(obj, scene, imported: Imported | None) -> bool:
    """Remove an origin that earlier terrains have left, before a new terrain is placed elsewhere; return whether.

    The origin stays if another add-on has written it, if another object has coordinates (a terrain, its baked mesh), or
    if it is on the new land: the land then fits the other objects of the scene.
    """
    if imported is None or not imported.crs or imported.place is None or not is_claimed(scene):
        return False
    if any(other.get(SRID) for other in scene.objects if other != obj) or _covers_origin(imported, origin_of(scene)):
        return False
    remove_origin(scene)
    return True


def adopt_system(obj, scene, imported: Imported | None) -> None:
    """Give the scene's origin the system in which a terrain was imported again; its place on Earth stays.

    Terrains of other systems move to their coordinates, unless the user has moved them. Nothing changes if another
    add-on has written the origin (`is_claimed` is False), if another object has coordinates in the scene's system, or
    if the raster is turned against the axes of its own system (`_is_straight` is False).
    """
    origin = origin_of(scene)
    if imported is None or not imported.crs or imported.place is None or not _is_straight(imported.place):
        return
    if origin is None or origin.crs == imported.crs or not is_claimed(scene):
        return
    if any(other.get(SRID) == origin.crs for other in scene.objects if other != obj):
        return
    try:
        x, y = reproject_point(origin.x, origin.y, origin.crs, imported.crs)
    except TerrainError:
        return
    others = [(other, imported_of(other.adaptive_terrain)) for other in session.terrains_of(scene) if other != obj]
    others = [other for other in others if other[1] and follows_coordinates(other[0], scene, other[1])]
    _claim_new_origin(scene, SceneOrigin(imported.crs, x, y, unit_lengths(imported.place)))
    for other, raster in others:
        place_terrain(other, scene, raster)


def _covers_origin(imported: Imported, origin: SceneOrigin) -> bool:
    """Return whether a scene's origin is inside a raster; False if its coordinates cannot be converted."""
    point = origin.x, origin.y
    if imported.crs != origin.crs:
        try:
            point = reproject_point(*point, origin.crs, imported.crs)
        except TerrainError:
            return False
    ((x, y),) = from_crs(imported.place, np.array([point])).tolist()
    return abs(x) <= imported.extent_m[0] / 2 and abs(y) <= imported.extent_m[1] / 2


def place_terrain(obj, scene, imported: Imported | None) -> list[str]:
    """Move a terrain to its coordinates in the scene, or give the scene those of its first terrain; return notes.

    A terrain in another coordinate system is placed by its reprojected origin, with a note. Without coordinates nothing
    changes, and there are no notes: [].
    """
    if imported is None or not imported.crs or imported.place is None:
        return []
    origin = origin_of(scene)
    if origin is None:
        _begin_origin(obj, scene, imported)
        return []
    if imported.crs != origin.crs:
        return _place_by_anchor(obj, origin, imported)
    (obj.location.x, obj.location.y), angle, (scale_x, scale_y) = _transform_of(obj, origin, imported)
    if abs(angle) > SAME:  # otherwise a user's rotation stays, as does a scale below
        obj.rotation_euler.z = angle
    if max(abs(scale_x - 1.0), abs(scale_y - 1.0)) > SAME:  # degrees at another latitude
        obj.scale.x, obj.scale.y = scale_x, scale_y
    return []


def _transform_of(obj, origin: SceneOrigin | None, imported: Imported) -> tuple | None:
    """Return x and y, the rotation about z in radians, and the scales along x and y that a terrain needs in a scene.

    Return None if the terrain has another coordinate system than the scene, or none.
    """
    if origin is None or imported.place is None or imported.crs != origin.crs:
        return None
    x, y = anchor_of(obj)
    # The anchor, and the points one metre east and north of it, in the world.
    points = from_crs(origin.place, to_crs(imported.place, np.array([[x, y], [x + 1.0, y], [x, y + 1.0]])))
    (east_x, east_y), (north_x, north_y) = points[1:] - points[0]
    scales = math.hypot(east_x, east_y), math.hypot(north_x, north_y)
    return points[0].tolist(), math.atan2(east_y, east_x), scales


def _is_plain(obj) -> bool:
    """Return whether an object is neither turned nor scaled."""
    turn = np.array(obj.matrix_basis.to_3x3())
    return bool(np.abs(turn - np.eye(3)).max() <= SAME)


def _begin_origin(obj, scene, imported: Imported) -> None:
    """Give the scene the coordinates of the world's origin by its first terrain.

    Nothing changes for a terrain that has a parent, or is turned or scaled, or whose raster is turned in its system.
    Latitude and longitude are left out if the system cannot be converted.
    """
    if obj.parent is not None or not _is_plain(obj) or not _is_straight(imported.place):
        return
    world_origin = np.array([anchor_of(obj)]) - np.array([obj.location[:2]])  # metres from the raster's middle
    ((x, y),) = to_crs(imported.place, world_origin).tolist()
    _claim_new_origin(scene, SceneOrigin(imported.crs, x, y, unit_lengths(imported.place)))


def _claim_new_origin(scene, origin: SceneOrigin) -> None:
    """Give a scene an origin of this add-on, with latitude and longitude if its system can be converted.

    `origin.metres`: lengths of a unit of the system's axes; they become exactly 1 if they differ from it by rounding.
    """
    lengths = [1.0 if abs(metres - 1.0) < SAME else metres for metres in origin.metres]
    try:
        longitude, latitude = reproject_point(origin.x, origin.y, origin.crs, WGS84)
    except TerrainError:
        set_origin(scene, origin._replace(metres=tuple(lengths)), latitude_longitude=None)
    else:
        set_origin(scene, origin._replace(metres=tuple(lengths)), (latitude, longitude))
    claim_origin(scene)


def _is_straight(place: Place) -> bool:
    """Return whether a terrain's axes are those of its coordinate system: x depends on east only, y on north only."""
    return place[1] == place[3] == 0.0


def _location_of(obj, origin: SceneOrigin | None, imported: Imported) -> list[float] | None:
    """Return x and y in a scene, metres, of a terrain's object at its coordinates.

    With a system other than the scene's, only the object's origin (the anchor) is converted, without a rotation. None
    if the terrain or the scene has no coordinates. Raises TerrainError if a point cannot be converted.
    """
    if origin is None or not imported.crs or imported.place is None:
        return None
    if imported.crs == origin.crs:
        return _transform_of(obj, origin, imported)[0]
    ((x, y),) = to_crs(imported.place, np.array([anchor_of(obj)])).tolist()
    there = reproject_point(x, y, imported.crs, origin.crs)
    return from_crs(origin.place, np.array([there]))[0].tolist()


def _place_by_anchor(obj, origin: SceneOrigin, imported: Imported) -> list[str]:
    """Place a terrain of another coordinate system by the point of it that is its object's origin; return a note.

    It stays where it is if that point cannot be converted.
    """
    try:
        obj.location.x, obj.location.y = _location_of(obj, origin, imported)
    except TerrainError as error:
        return [f"{_systems(obj, origin, imported)}, and it stays where it is ({error.what}): {_remedy(origin)}."]
    return system_notes(obj, origin, imported)


def system_notes(obj, origin: SceneOrigin | None, imported: Imported | None) -> list[str]:
    """Return a note about a terrain of another coordinate system than its scene, which is true until one is changed.

    [] for a terrain of the scene's system, and if one of them has no coordinates.
    """
    if origin is None or imported is None or not imported.crs or imported.place is None or imported.crs == origin.crs:
        return []
    return [
        f"{_systems(obj, origin, imported)}, which differ in direction and scale: only the terrain's origin is in the "
        f"right place, or not even that if you have moved it. To place all of it exactly, {_remedy(origin)}."
    ]


def _systems(obj, origin: SceneOrigin, imported: Imported) -> str:
    """Return a clause about the different systems of a terrain and its scene."""
    return f"{shown(obj.name)} is in {shown(imported.crs, 40)} and the scene in {shown(origin.crs, 40)}"


def _remedy(origin: SceneOrigin) -> str:
    """Return a clause about how to place a terrain in a scene with another system; no import reprojects to degrees."""
    if is_in_degrees(origin.place):
        return "import the terrains in degrees again with utm as Reproject, and the scene takes over their system"
    return "import it with the scene's system as Reproject"


HANDLERS = {
    "load_post": on_load_post,
    "undo_pre": on_undo_pre,
    "redo_pre": on_undo_pre,
    "undo_post": on_undo,
    "redo_post": on_undo,
}
