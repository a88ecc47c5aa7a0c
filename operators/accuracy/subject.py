# SPDX-License-Identifier: GPL-3.0-or-later
"""The terrains of a store or a scene whose accuracy is measured, and their views."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...cbt_terrain.accuracy.sweep_settings import Setting, settings_for
from ...cbt_terrain.accuracy.timed_runs import TimedFrame
from ...cbt_terrain.attributes.plan import AttributePlan, plan
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.view.camera_path import read_camera_path
from ...cbt_terrain.view.criterion import Criterion, requested_unit
from ...cbt_terrain.view.linear import length
from ...cbt_terrain.view.view import View
from ..export.blend_files import file_name
from ..session.pauses import handlers_paused

if TYPE_CHECKING:
    from ...cbt_terrain.accuracy.crops import Crop
    from ...cbt_terrain.accuracy.rows import Row

# Number of frames of a camera path that are measured if none are named.
SPREAD = 4
# The view where none is given: from the south-west, a third of a right angle above the horizon.
LOOK_FROM, FOV_DEG = (-0.6, -0.65, 0.47), 50.0


@dataclass
class AccuracySubject:
    """One terrain that is measured.

    Attributes:
        name, heights: start of the names of its files, and its height field.
        frames: those to measure.
        frame_numbers: numbers of these frames, [] for a single view without one.
        seen: the camera, as a phrase after "seen".
        current: the setting that the scene (or an export) uses, None if it has no error.
        base: the criterion that gives guard band and culling.
        rows: the measured settings.
        notes: sentences for the page.
        crops: pictures of some of the errors.
        object_name: the object's name as `file_name` returns it, "" for a store.
        effects: the attributes that the scene reads.
    """

    name: str
    heights: HeightField
    frames: list[TimedFrame]
    frame_numbers: list[int]
    seen: str
    current: Setting | None
    base: Criterion = field(default_factory=Criterion)
    rows: "list[Row]" = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    crops: "list[Crop]" = field(default_factory=list)
    object_name: str = ""
    effects: AttributePlan = AttributePlan()

    @property
    def title(self) -> str:
        """Return the source file's name, or `name` if the store names none, and the object's name if it differs."""
        file = Path(self.heights.provenance.get("settings", {}).get("source", "")).name or self.name
        return (
            file
            if file_slug(self.object_name or Path(file).stem) == file_slug(Path(file).stem)
            else f"{file}: {self.object_name}"
        )

    @property
    def settings(self) -> list[Setting]:
        """Return the settings of a whole sweep, after the current one if the sweep lacks it."""
        settings = settings_for(self.heights, self.frames[0], self.base.morph)
        return settings if self.current is None or self.current in settings else [self.current, *settings]


def store_subject(
    store: Path, path: Path | None, frames: Sequence[int] | None, resolution: tuple[int, int]
) -> AccuracySubject:
    """Return the subject of a store, seen along a camera path, or from a position that shows all of it (no path).

    frames: numbers of frames of the path, by default a few that are evenly spaced. resolution: width and height,
    pixels. Raises TerrainError for a store or a path that cannot be read.
    """
    heights = open_store(store)
    name, current = file_slug(Path(store).stem), Setting("px", Criterion().error_px)
    size = f"{resolution[0]} x {resolution[1]} pixels"
    if path is None:
        view = whole_view(heights, resolution)
        seen = f"as a whole from the south-west, {size}"
        return AccuracySubject(name, heights, [TimedFrame([view])], frame_numbers=[], seen=seen, current=current)
    flight = read_camera_path(path)
    last = math.floor(flight.frames[-1])
    numbers = list(frames or spread_frames(math.ceil(flight.frames[0]), last))

    def frame_at(frame: int) -> TimedFrame:
        """Return one frame of the path to be measured."""
        return TimedFrame([flight.view(frame, resolution)])

    # Each frame has the next one with it, for measuring popping.
    timed = [TimedFrame(frame_at(n).views, after=frame_at(n + 1) if n + 1 <= last else None) for n in numbers]
    return AccuracySubject(name, heights, timed, numbers, f"along {Path(path).name}, {size}", current)


def scene_subjects(
    blend: Path, camera: str | None, frames: Sequence[int] | None, resolution: tuple[int, int] | None
) -> list[AccuracySubject]:
    """Open a .blend file and return a subject for each of its terrains, with the settings of its render.

    camera: name of a camera, None for the scene's. frames: by default the file's current frame. resolution: pixels,
    None for the scene's. Triangles that a clean-up cuts away are measured, too: they change no error of the others.
    Raises TerrainError.
    """
    from ..export.frame_sources import SceneFrames

    source = SceneFrames(blend, camera, resolution)
    import bpy

    numbers = list(frames or [source.scene.frame_current])
    look = {"camera": source.camera, "resolution": resolution}
    found = gather_views(source.scene, bpy.context.view_layer, source.objects, numbers, **look)
    return [shown.subject(f"the camera of {Path(blend).name}") for shown in found]


@dataclass(frozen=True)
class Look:
    """How a terrain is seen: its Request at the first of some frames, and its views and placement in each of them.

    `name`: the object's, as a start of file names. `frames`: those to measure. `frame_numbers`: their numbers.
    """

    name: str
    request: object
    frames: list[TimedFrame]
    frame_numbers: list[int]

    def subject(self, through: str) -> AccuracySubject:
        """Return the terrain as a subject to be measured. It opens the height field, but uses nothing of Blender.

        A caller on a background thread must hold `session.engine_lock`. through: the camera, as a phrase after
        "through".
        """
        from ..session import session

        size = " x ".join(f"{pixels:g}" for pixels in self.frames[0].views[0].resolution)
        request, seen = self.request, f"through {through}, {size} pixels"
        heights, current = session.field_of(request), setting_of_request(request)
        found = AccuracySubject(self.name, heights, self.frames, self.frame_numbers, seen, current, request.criterion)
        found.object_name, found.effects = self.name, plan(request.effects.requests)
        found.notes += omission_notes(request.criterion)
        return found


def gather_views(scene, view_layer, objects, numbers: Sequence[int], **look) -> list[Look]:
    """Visit the frames `numbers` of a scene and return a Look for each terrain of `objects`.

    Each frame has the next one with it, if the scene has one, for measuring popping. The scene stays at the last of
    them. look: `camera`, `resolution` or `overrides` in place of those of the scene. Raises TerrainError. view_layer:
    the scene's, which the frames evaluate.
    """
    from ..terrain.request import RENDER, gather

    requests, shown = {}, {}
    with handlers_paused():
        for number in sorted({n + step for n in numbers for step in (0, 1) if n + step <= max(scene.frame_end, n)}):
            scene.frame_set(number)
            for obj in objects:
                request = gather(obj, view_layer.depsgraph, RENDER, **look)
                # A criterion in metres needs no view, but its errors are measured on screen too.
                views = request.views or gather(obj, view_layer.depsgraph, RENDER, criterion=Criterion(), **look).views
                requests[obj.name, number] = request
                shown[obj.name, number] = TimedFrame(
                    views, request.placement, request.vertical_scale, request.vertical_offset
                )
    return [
        Look(
            file_name(obj),
            requests[obj.name, numbers[0]],
            [replace(shown[obj.name, n], after=shown.get((obj.name, n + 1))) for n in numbers],
            list(numbers),
        )
        for obj in objects
    ]


def setting_of_request(request) -> Setting | None:
    """Return a request's own setting, which a report measures beside others and marks.

    It is the error in pixels, or in metres if that alone is limited, with the depth limit, meshlets and interpolation;
    None without an error.
    """
    criterion = request.criterion
    unit = requested_unit(criterion)
    if not unit:
        return None
    limits = {"max_depth": criterion.max_depth, "meshlet": criterion.meshlet}
    return Setting(unit, getattr(criterion, f"error_{unit}"), interpolation=request.interpolation, **limits)


def omission_notes(criterion: Criterion) -> list[str]:
    """Return sentences about the parts of a criterion that a sweep leaves out."""
    notes = []
    if not requested_unit(criterion):
        notes.append("The terrain asks for no error, so no setting is marked as the current one.")
    if criterion.error_px and criterion.error_m:
        notes.append("The terrain asks for metres too; the setting marked as current is its error in pixels alone.")
    if criterion.edge_px or criterion.area_px or criterion.max_triangles is not None:
        notes.append("Edge lengths, areas and limits of triangles that the terrain asks for are left out here.")
    return notes


def whole_view(heights: HeightField, resolution: tuple[int, int]) -> View:
    """Return a perspective view from LOOK_FROM that shows the whole terrain without vertical scale and offset."""
    lattice = heights.lattice
    x, y = (lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y
    radius = 0.5 * math.hypot(x, y, heights.max_height - heights.min_height)
    middle = np.array([0.0, 0.0, 0.5 * (heights.max_height + heights.min_height)])
    # Half of the field of view along the shorter side of the picture, radians.
    half_angle = math.atan(math.tan(math.radians(FOV_DEG) / 2) * min(resolution) / max(resolution))
    distance = radius / math.sin(half_angle)
    eye = middle + distance * np.array(LOOK_FROM) / length(LOOK_FROM)
    return View.look(eye, middle, fov_deg=FOV_DEG, resolution=resolution, clip=(1e-3 * distance, 10 * distance))


def spread_frames(first: int, last: int) -> list[int]:
    """Return at most SPREAD whole frames from first to last, evenly spaced; [first] if `last` is before it."""
    count = min(SPREAD, max(last, first) - first + 1)
    return sorted({round(n) for n in np.linspace(first, max(last, first), count)})


def file_slug(name: str) -> str:
    """Return a name in lower case with only characters that a file name may have."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "terrain"
