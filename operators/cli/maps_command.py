# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain maps`: effects of a store or of a scene's terrains, baked into images."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.attributes.folder import JSON_NAME
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.view.camera_path import read_camera_path
from ...cbt_terrain.view.view import View
from ..export.blend_files import file_name
from ..export.frame_sources import SceneFrames, StoreFrames
from ..maps.baking import MapRequest, bake_maps, check_names, summary
from ..text.console import Progress

READER = "this command"
MAX_FRAMES = 100_000  # whose views of a path are kept at once


@dataclass(frozen=True)
class MapSubject:
    """One terrain whose maps are baked: its name for the printed lines, its height field, and the request."""

    name: str
    field: object
    request: MapRequest


def run(
    subjects: list[MapSubject],
    budget_mb: float | None = None,
    form: str | None = None,
    show_progress: bool | None = None,
) -> None:
    """Bake the maps of every subject and print a line for each.

    `budget_mb`: megabytes, shared evenly by the subjects; `form`: png or exr; None keeps the values of the requests.
    `show_progress`: whether to draw a bar; None: in a terminal only.
    """
    with Progress(len(subjects), "maps", show_progress) as bar:
        for done, subject in enumerate(subjects):
            changes = {} if form is None else {"form": form}
            changes |= {} if budget_mb is None else {"budget_mb": budget_mb / len(subjects)}
            request = replace(subject.request, **changes)
            baked = bake_maps(request, subject.field, lambda fraction, done=done: bar.to(done + fraction))
            bar.say(summary(baked, subject.name))
            bar.say(f"{request.folder / JSON_NAME} says what they are")


def subjects_of_store(
    store: Path,
    out: Path,
    names: Sequence[str],
    path: Path | None,
    frames: Sequence[int] | None,
    resolution: tuple[int, int],
) -> list[MapSubject]:
    """Return the terrain of a store as the only subject, with the views that decide how fine its maps are.

    `out`: folder of the maps `names`. `path`: camera path; None bakes the whole terrain. `frames`: numbers of frames of
    the path, None for all whole frames. `resolution`: pixels.
    """
    views = () if path is None else views_along(path, frames, resolution)
    requests = tuple(AttributeRequest(name, readers=(READER,)) for name in check_names(names))
    request = MapRequest(requests, out, views, only_seen=bool(views))  # ground outside all views: coarsest images
    return [MapSubject(StoreFrames.name, open_store(store), request)]


def views_along(path: Path, frames: Sequence[int] | None, resolution: tuple[int, int]) -> tuple[View, ...]:
    """Return the views along a camera path at `frames`; None or () for all its whole frames.

    resolution: pixels. Raises TerrainError for more than MAX_FRAMES.
    """
    flight = read_camera_path(path)
    if not frames:
        first, last = math.ceil(flight.frames[0]), math.floor(flight.frames[-1])
        frames = range(first, max(last, first) + 1)
    if len(frames) > MAX_FRAMES:
        raise TerrainError(f"The camera path has {len(frames):,} frames", fix="name those that count with --frames")
    return tuple(flight.view(frame, resolution) for frame in frames)


def subjects_of_scene(
    blend: Path,
    out: Path,
    names: Sequence[str] | None,
    camera: str | None,
    resolution: tuple[int, int] | None,
    frames: Sequence[int] | None,
) -> list[MapSubject]:
    """Open a .blend file and return its terrains, each with its map settings and a folder inside `out`.

    `names`, `frames`: maps to bake and frames whose views count, None for those of each terrain's settings. `camera`:
    name of a camera, None for the scene's. `resolution`: pixels, None for the scene's. Land is shaped if it is missing.
    """
    source = SceneFrames(blend, camera, resolution)

    from ...cbt_terrain.height_operators.derived_store import raster_of
    from ..maps.request import visit_for_request
    from ..session import session

    options = {"camera": source.camera, "resolution": resolution}
    subjects = []
    for obj in source.objects:
        *_, request = visit_for_request(obj, source.scene, names, frames, **options)  # the last item: progress is first
        request = replace(request, folder=out / file_name(obj))
        # Shapes missing land. verified: checks all of its files first, since a bake reads them all.
        field = raster_of(request.store, request.land, session.open_field, verified=True)
        subjects.append(MapSubject(obj.name, field, request))
    return subjects
