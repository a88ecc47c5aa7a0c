# SPDX-License-Identifier: GPL-3.0-or-later
"""The one place that reads a terrain's properties: object and scene in, plain numbers for the engine out."""

import hashlib
import math
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from ...cbt_terrain.accuracy.cost_curve import CostCurve
from ...cbt_terrain.accuracy.time_correction import TimeCorrection
from ...cbt_terrain.attributes.layered_detail import LayeredDetail
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.displacement_layers import Ground
from ...cbt_terrain.field.heightfield import INTERPOLATIONS, FieldKey
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.height_operators.requested_tiles import SeenTiles
from ...cbt_terrain.view.criterion import Criterion, requested_unit
from ...cbt_terrain.view.linear import product
from ...cbt_terrain.view.settings import SETTINGS
from ...cbt_terrain.view.view import View
from ..attributes.request import Effects, gather_effects
from ..bridge import camera as cameras
from ..bridge.cleanup import Cleanup, plan_triangles
from ..bridge.evaluated import anchor_of, evaluated_or_still, placement_of, raster_placement_of
from ..bridge.instances import shown_places
from ..bridge.scene_paths import absolute_path, no_heights
from ..land.request import land_of
from ..layers.properties import layers_of
from ..scatter.request import Scatters, gather_scatters
from .camera_source import follows_viewport
from .detail_properties import value_of
from .displacement_properties import displacement_of
from .overrides import NO_OVERRIDES, Overrides
from .properties import CHOSEN_CAMERA

VIEWPORT, RENDER = "VIEWPORT", "RENDER"
ERRORS = "error_px", "error_m"  # varied by a time budget


@dataclass(frozen=True, eq=False)
class Request:
    """Input of one update, without references to Blender's data, so that a worker thread may use it.

    Attributes:
        store: folder of the height field; in a viewport that of its shaped land, if there is some.
        changed_ns: time of the last change of that folder, which tells it from one that is made again or repaired.
        land: land to be shaped from it first, or None.
        interpolation: the height field's, by its name in heightfield.py.
        ground: displacement on it, or None.
        criterion: how fine the mesh has to be.
        views: of the cameras or viewports to refine for, [] if the criterion needs none.
        placement: float64 [4, 4], the terrain's space to the world, metres.
        anchor: origin of that space, metres east and north of the raster's middle.
        vertical_scale, vertical_offset: z in that space is height * scale + offset, metres.
        smooth: shade the mesh smoothly.
        cleanup: parts of the finished mesh to cut away.
        overlay: colours of the mesh.
        max_ms: time budget of the criterion's error, None without one; `note`: why it has no effect, or "".
        frozen: triangles to keep whatever the criterion, see frozen.py; "" for a mesh that follows its camera.
        effects: effects whose attributes the mesh gets.
        scatters: visible objects with points on the terrain.
        curve: cost curve of the time budget, None without one.
    """

    store: str
    changed_ns: int
    land: Land | None
    interpolation: str
    ground: Ground | LayeredDetail | None
    criterion: Criterion
    views: list[View]
    placement: np.ndarray
    vertical_scale: float
    vertical_offset: float
    smooth: bool
    cleanup: Cleanup
    overlay: str
    max_ms: float | None
    note: str
    frozen: str
    effects: Effects
    scatters: Scatters = Scatters()
    curve: CostCurve | None = None
    anchor: tuple[float, float] = (0.0, 0.0)

    def key(self) -> tuple:
        """Return a key that is equal for equal requests: the live update skips a request that it has answered."""
        shown = self.smooth, self.cleanup.key(), self.overlay, self.note, self.effects, self.scatters.key()
        return self.store, self.changed_ns, self.land, self.interpolation, self.ground, *self._mesh_key(), *shown

    def digest(self, field_key: FieldKey) -> str:
        """Return the hex digest of everything that determines the mesh before clean-up and its errors.

        That is the key of the height field, the criterion, the views and the placement.
        """
        return hashlib.blake2b(repr((str(field_key), *self._mesh_key())).encode(), digest_size=16).hexdigest()

    def _mesh_key(self) -> tuple:
        """Return the key of the inputs that determine the triangles."""
        views = tuple(view.key() for view in self.views)
        heights = self.vertical_scale, self.vertical_offset
        # An anchor of 0 is left out, so that digests stay those of versions without anchors.
        placed = self.placement.tobytes(), *([self.anchor] if any(self.anchor) else [])
        return self.criterion, views, *placed, heights, self.frozen


def gather(
    obj,
    depsgraph,
    mode: str = VIEWPORT,
    *,
    criterion: Criterion | None = None,
    camera=None,
    scene_cameras: Sequence = (None,),
    resolution: tuple[int, int] | None = None,
    overrides: Overrides = NO_OVERRIDES,
    about_middle: bool = False,
) -> Request:
    """Read the settings of the terrain `obj` and the camera that it is refined for, as `depsgraph` evaluated them.

    `mode` picks the settings of the viewport or of the render. `criterion`, `camera` (an object), `resolution` (pixels)
    and `overrides` replace those of the settings and the scene. `scene_cameras`: objects that the scene is rendered
    through, None for its own camera; strips of a video edit may name others. Frozen triangles are ignored if there is a
    `criterion` or an override other than `effects`; the time budget is ignored if there is a `criterion` or an
    overridden error. `about_middle`: the origin of the terrain's space is the raster's middle, not the anchor. Raises
    TerrainError.
    """
    evaluated = obj.evaluated_get(depsgraph)
    settings = evaluated.adaptive_terrain  # the evaluated copy has the values that animation and drivers set
    if not settings.store:
        raise no_heights(obj)
    interpolation = overrides.interpolation or settings.interpolation
    if interpolation not in INTERPOLATIONS:  # a driver or a script may set any number
        raise TerrainError(f"The terrain {obj.name!r} has an unknown interpolation", fix="choose one on its panel")
    anchor = (0.0, 0.0) if about_middle else anchor_of(evaluated)
    placement = raster_placement_of(evaluated) if about_middle else placement_of(evaluated)
    # note: why the time budget cannot be used, else "". frozen: the saved triangles of a frozen terrain, else "".
    max_ms, note, frozen, curve = None, "", "", None
    if criterion is None:
        frozen = settings.frozen if replace(overrides, effects=None) == NO_OVERRIDES else ""
        detail = settings.render if mode == RENDER else settings.viewport
        with _name_terrain_in_errors(obj.name):
            criterion = criterion_from(detail, overrides)
        if overrides.criterion.keys().isdisjoint(ERRORS):
            criterion, note = within_time(criterion, detail)
            max_ms = detail.max_ms if detail.limit_time else None
            curve = CostCurve.from_json(detail.curve) if detail.limit_time and not note else None
    find_views = partial(_find_views, evaluated, depsgraph, mode, camera, scene_cameras, resolution)
    views = []
    if criterion.needs_view:
        with _name_terrain_in_errors(obj.name):
            views = find_views()
    store, land = absolute_path(settings.store), land_of(obj, evaluated, depsgraph, waits=mode == RENDER)
    if land is not None:
        if views and mode == RENDER and land.of_views:  # only land in view has to be fine
            scale_and_offset = settings.vertical_scale, settings.vertical_offset
            seen = SeenTiles(tuple(views), raster_placement_of(evaluated), criterion.error_px, *scale_and_offset)
            land = replace(land, seen=seen)
        elif mode != RENDER:
            store, land = _shown_land(store, land, frozen)  # a shaped store, or a preview until there is one
    cleanup = cleanup_from(settings.cleanup, evaluated, depsgraph)
    if cleanup.active:  # a cut part would hide ground that is seen through the cut: none counts as hidden
        criterion = replace(criterion, hidden_factor=1.0)
    return Request(
        store=store,
        changed_ns=stores.changed_ns(store),
        land=land,
        interpolation=interpolation,
        ground=overrides.ground or ground_of(settings, obj.name),
        criterion=criterion,
        views=views,
        placement=placement,
        vertical_scale=settings.vertical_scale,
        vertical_offset=settings.vertical_offset,
        smooth=settings.smooth,
        cleanup=cleanup,
        overlay=settings.overlay,
        max_ms=max_ms,
        note=note,
        frozen=frozen,
        effects=gather_effects(obj, evaluated, placement, depsgraph, mode, overrides.effects),
        scatters=gather_scatters(obj, depsgraph, render=mode == RENDER, views=lambda: views or find_views()),
        curve=curve,
        anchor=anchor,
    )


def _shown_land(store: str, land: Land, frozen: str) -> tuple[str, Land | None]:
    """Return the store that a viewport shows, and the land to preview on it, None if that store is already shaped.

    store: of the terrain's settings. frozen: the saved triangles of a frozen terrain, else "".
    """
    if shown := land.shown:
        return shown, None
    # The tree of a frozen mesh fits the store's raster only; a preview has another raster.
    return store, None if frozen else land


@contextmanager
def _name_terrain_in_errors(name: str):
    """Add the terrain's name to TerrainErrors of the `with` block: a scene may have several."""
    try:
        yield
    except TerrainError as error:
        raise error.within(f"The terrain {name!r} cannot be refined") from None


def ground_of(settings, name: str) -> Ground | LayeredDetail | None:
    """Return the displacement of a terrain and of its splat layers; None if no amplitude is above 0.

    name: the terrain's, for errors. Raises TerrainError.
    """
    with _name_terrain_in_errors(name):  # a driver or a script may set any number
        everywhere = displacement_of(settings.ground)
        found = ((number, displacement_of(layer.detail)) for number, layer in enumerate(settings.layers))
        details = tuple((number, detail) for number, detail in found if detail is not None)
        return LayeredDetail(everywhere, layers_of(settings), details) if details else everywhere


def criterion_from(detail, overrides: Overrides = NO_OVERRIDES) -> Criterion:
    """Return the criterion of a DetailSettings, with `overrides` in place of its values.

    Raises TerrainError for invalid values, also if every criterion is off.
    """
    return Criterion(**{setting.name: value_of(detail, setting) for setting in SETTINGS} | overrides.criterion)


def within_time(criterion: Criterion, detail) -> tuple[Criterion, str]:
    """Return the criterion with the finest error that fits the time budget of a DetailSettings, and "".

    Without a usable measured curve, return `criterion` unchanged and the reason. The error depends on the curve and
    the budget alone, so a frame is the same on every machine.
    """
    if not detail.limit_time:
        return criterion, ""
    unit = requested_unit(criterion)
    if not unit:
        return criterion, "Time budget needs an error to vary: set Screen Error or Vertical Error"
    if not detail.curve:
        if detail.no_curve:
            return criterion, "Time budget needs a curve, but times differed: Measure Accuracy again"
        return criterion, "Time budget needs a measured curve: press Measure Accuracy"
    try:
        curve = CostCurve.from_json(detail.curve)
        error = curve.error_for_ms(detail.max_ms)
    except TerrainError as damaged:
        return criterion, str(damaged)
    if curve.unit != unit:
        return criterion, f"Time budget needs a curve measured in {unit}: press Measure Accuracy again"
    return replace(criterion, **{f"error_{unit}": error}), ""


def correct_for_time(request: Request, correction: TimeCorrection) -> Request:
    """Return the request with an error that fits its time budget by the times of recent live updates.

    It is unchanged without a budget. correction: ratio of those times to the measured cost curve.
    """
    if request.curve is None:
        return request
    error = correction.error_for_ms(request.curve, request.max_ms)
    return replace(request, criterion=replace(request.criterion, **{f"error_{request.curve.unit}": error}))


def record_time(request: Request, ms: float, correction: TimeCorrection) -> None:
    """Record the time of a live update, by which `correct_for_time` adapts later errors.

    ms: milliseconds that the update took.
    """
    if request.curve is not None:
        correction.record(request.curve, getattr(request.criterion, f"error_{request.curve.unit}"), ms)


def cleanup_from(settings, terrain, depsgraph) -> Cleanup:
    """Return the clean-up of a CleanupSettings for the evaluated object `terrain`.

    Raises TerrainError for a boundary that is the terrain itself or whose shape in this frame is unknown, and for a
    height that is not finite.
    """
    boundary = None
    if settings.boundary is not None:
        if settings.boundary.original == terrain.original:  # its mesh would be cut by the last one, and never grow
            raise TerrainError(
                f"The terrain {terrain.name!r} is its own boundary", fix="choose another object, or none"
            )
        shape, matrix = evaluated_or_still(depsgraph, settings.boundary, "boundary")
        boundary = plan_triangles(shape, matrix, Matrix(terrain.matrix_world).inverted(), "boundary")
    if settings.use_below and not math.isfinite(settings.below):
        raise TerrainError(
            f"The terrain {terrain.name!r} has {settings.below} as the height of Delete Below", expected="a number"
        )
    return Cleanup(settings.below if settings.use_below else None, boundary)


def _find_views(terrain, depsgraph, *look) -> list[View]:
    """Return the views that a terrain is refined for: those of `_views_of_cameras`, for each place where it is shown.

    An instance of the terrain's collection is seen as the terrain itself from another place. terrain: evaluated.
    """
    views = _views_of_cameras(terrain, depsgraph, *look)
    places = shown_places(terrain.original, depsgraph)
    if len(places) == 1 and np.array_equal(places[0], np.eye(4)):
        return views
    moved = [(view, product(view.world_to_camera, place)) for place in places for view in views]
    return [replace(view, world_to_camera=matrix) for view, matrix in moved]


def _views_of_cameras(terrain, depsgraph, mode: str, camera, scene_cameras: Sequence, resolution) -> list[View]:
    """Return the views of viewports, of the terrain's chosen camera or of the scene's.

    A terrain that follows viewports gets the scene's camera if there are none, and in a render. terrain: evaluated.
    camera, resolution: replace those of the settings and of the scene unless they are None. scene_cameras: those of the
    scene, see `gather`. Raises TerrainError without a camera.
    """
    scene, settings = depsgraph.scene, terrain.adaptive_terrain
    if camera is None and mode == VIEWPORT and follows_viewport(terrain, scene):
        views = cameras.views_from_windows(bpy.context.window_manager)
        if views:
            return views
    if camera is None and settings.camera_source == CHOSEN_CAMERA:
        if settings.camera is None:
            raise TerrainError(
                "No camera is chosen", fix="choose one on the terrain's panel, or use the scene's camera"
            )
        camera = settings.camera.original
    active = cameras.active_camera(scene)
    through = [camera] if camera else [other or active for other in scene_cameras]
    return [view for eye in through for view in cameras.views_from_scene(scene, eye, depsgraph, resolution)]
