# SPDX-License-Identifier: GPL-3.0-or-later
"""The request for a bake of maps, in plain numbers, from a scene and its settings."""

from collections.abc import Iterable, Iterator

import bpy

from ...cbt_terrain.attributes.attribute import PICTURE
from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.owned_files import check_folder
from ...cbt_terrain.view.criterion import Criterion
from ..session.shot import frames_of, visit_views
from ..terrain.overrides import Overrides
from ..terrain.request import RENDER, gather
from . import images as map_images
from .baking import MapRequest, check_names
from .properties import CHOSEN, FRAME, SHOT, map_folder

WITHOUT_VIEW = Criterion(error_px=0.0, error_m=1.0)  # the whole terrain needs no camera


def chosen_maps(obj, depsgraph) -> set[str]:
    """Return the attributes whose maps the terrain's settings choose, or that its materials read.

    It is empty if the user has chosen none. Raises TerrainError if the materials decide and read none.
    """
    settings = obj.adaptive_terrain.maps
    if settings.which == CHOSEN:
        return set(settings.chosen)
    requests = gather(obj, depsgraph, RENDER).effects.requests
    # PICTURE: attributes that only pixels show, so that a map can take their place.
    read = {item.name for item in requests if item.family == PICTURE} | maps_shown_by_materials(obj)
    if not read:
        raise TerrainError(
            f"No material of {obj.name!r} reads an attribute or a map",
            fix="choose the maps, or make a Terrain Material",
        )
    return read


def maps_shown_by_materials(obj) -> set[str]:
    """Return the names of the maps, baked or not, that image textures of a terrain's materials show."""
    folder = map_folder(obj)
    found = {path.name.partition(".")[0] for path in map_images.images_of_materials(obj) if path.parent == folder}
    return found & set(ATTRIBUTES)


def visit_for_request(
    obj, scene, names: Iterable[str] | None = None, frames: Iterable[int] | None = None, **options
) -> Iterator:
    """Visit the frames whose views decide how fine the maps are; yield the fraction done after each, then the
    MapRequest.

    The scene then returns to its frame. The terrain gets its own folder of maps if it has none. Raises TerrainError.

    Args:
        names: maps in place of those of the settings.
        frames: frames in place of those of the settings; ground that none of them shows gets the coarsest images.
        options: keyword arguments of `gather`: `camera` or `resolution` in place of those of the scene.
    """
    settings, depsgraph = obj.adaptive_terrain.maps, bpy.context.evaluated_depsgraph_get()
    options = {"about_middle": True, **options}  # maps do not depend on the anchor
    map_images.reserve_folder(obj)
    for folder in (map_images.map_folder(obj).parent, map_images.map_folder(obj)):
        check_folder(folder)  # chosen by the scene: no link in it may lead elsewhere
    names = check_names(chosen_maps(obj, depsgraph) if names is None else names)
    if settings.folder.startswith("//") and not bpy.data.filepath:
        raise TerrainError(
            f"The folder of the maps, {settings.folder!r}, is relative to a .blend file that was never saved",
            fix="save the file, or choose another folder",
        )
    # At the present frame, for everything except the views.
    first = gather(obj, depsgraph, RENDER, criterion=WITHOUT_VIEW, overrides=Overrides(effects=names), **options)
    only_seen = frames is not None or settings.frames == SHOT
    if frames is None:
        frames = {FRAME: [scene.frame_current], SHOT: frames_of(scene)}
        frames = frames.get(settings.frames, [])  # none for WHOLE: the whole terrain, whatever views show
    views = []
    for views in visit_views(obj, scene, frames, first.placement, **options):  # fractions, and at the end the views
        if isinstance(views, float):
            yield views
    budget = settings.budget_mb if settings.use_budget else None
    yield MapRequest(
        requests=first.effects.requests,
        folder=map_folder(obj),
        views=tuple(views),
        placement=first.placement,
        only_seen=only_seen,
        budget_mb=budget,
        form=settings.form,
        vertical_scale=first.vertical_scale,
        vertical_offset=first.vertical_offset,
        store=first.store,
        land=first.land,
    )
