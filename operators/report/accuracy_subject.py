# SPDX-License-Identifier: GPL-3.0-or-later
"""What accuracy is measured of: terrains of a store or a scene, and from where they are seen."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...cbt_terrain.accuracy.crops import Crop
from ...cbt_terrain.accuracy.sweep import Row
from ...cbt_terrain.accuracy.sweep_settings import Setting, settings_for
from ...cbt_terrain.accuracy.timed_runs import Frame
from ...cbt_terrain.ask.camera_path import read_camera_path
from ...cbt_terrain.ask.criterion import Criterion, unit_asked
from ...cbt_terrain.ask.linear import length
from ...cbt_terrain.ask.view import View
from ...cbt_terrain.evaluate.plan import Plan, plan
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import open_store
from ..output.frame_sources import SceneFrames, file_name
from ..scene.pauses import paused

# Frames of a camera path that are measured where none are named: so many, evenly spread.
SPREAD = 4
# The view where none is given: from the south-west, a third of a right angle above the horizon.
LOOK_FROM, FOV_DEG = (-0.6, -0.65, 0.47), 50.0


@dataclass
class Subject:
    """One terrain that is measured. `numbers`: of the frames. `seen`: from where, in words. `current`: the setting that
    the scene (or an export) uses, None where it asks for no error. `base`: where guard band and culling come from.
    `crops`: what some of the errors look like. `called`: the object's name, where there is one. `effects`: those that
    the scene reads."""

    name: str
    heights: HeightField
    frames: list[Frame]
    numbers: list[int]
    seen: str
    current: Setting | None
    base: Criterion = field(default_factory=Criterion)
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    crops: list[Crop] = field(default_factory=list)
    called: str = ""
    effects: Plan = Plan()

    @property
    def title(self) -> str:
        """The file that the heights are from, as its owner knows it; and the object, where it has a name of its own."""
        file = Path(self.heights.provenance.get("settings", {}).get("source", "")).name or self.name
        return file if slug(self.called or Path(file).stem) == slug(Path(file).stem) else f"{file}: {self.called}"

    @property
    def settings(self) -> list[Setting]:
        """A whole sweep, and the current setting if that is none of it."""
        settings = settings_for(self.heights, self.frames[0], self.base.morph)
        return settings if self.current is None or self.current in settings else [self.current, *settings]


def store_subject(store: Path, path: Path | None, frames: Sequence[int] | None, resolution: tuple[int, int]) -> Subject:
    """A store as seen along a camera path, or from a place from which all of it is in the picture."""
    heights = open_store(store)
    name, current = slug(Path(store).stem), Setting("px", Criterion().error_px)
    size = f"{resolution[0]} x {resolution[1]} pixels"
    if path is None:
        view = overview(heights, resolution)
        return Subject(name, heights, [Frame([view])], [], f"as a whole from the south-west, {size}", current)
    flight = read_camera_path(path)
    last = math.floor(flight.frames[-1])
    numbers = list(frames or spread(math.ceil(flight.frames[0]), last))

    def at(frame: int) -> Frame:
        return Frame([flight.view(frame, resolution)])

    shown = [Frame(at(n).views, after=at(n + 1) if n + 1 <= last else None) for n in numbers]
    return Subject(name, heights, shown, numbers, f"along {Path(path).name}, {size}", current)


def scene_subjects(
    blend: Path, camera: str | None, frames: Sequence[int] | None, resolution: tuple[int, int] | None
) -> list[Subject]:
    """The terrains of a .blend file at the detail of the render; without `frames`, at the file's current frame.

    What a clean-up cuts away is measured too: it changes no error of what is left.
    """
    source = SceneFrames(blend, camera, resolution)
    import bpy

    numbers = list(frames or [source.scene.frame_current])
    look = {"camera": source.camera, "resolution": resolution}
    looks = looks_at(source.scene, bpy.context.view_layer, source.objects, numbers, **look)
    return [looked.subject(f"the camera of {Path(blend).name}") for looked in looks]


@dataclass(frozen=True)
class Look:
    """What is asked of a terrain at the first of some frames, and what each frame shows of it."""

    name: str
    request: object
    frames: list[Frame]
    numbers: list[int]

    def subject(self, through: str) -> Subject:
        """The terrain, opened, seen `through` a camera (in words); touches nothing of Blender."""
        from ..scene import session

        size = " x ".join(f"{pixels:g}" for pixels in self.frames[0].views[0].resolution)
        request, seen = self.request, f"through {through}, {size} pixels"
        heights, current = session.field_of(request), current_setting(request)
        found = Subject(self.name, heights, self.frames, self.numbers, seen, current, request.criterion)
        found.called, found.effects = self.name, plan(request.effects.asked)
        found.notes += notes_on(request.criterion)
        return found


def looks_at(scene, view_layer, objects, numbers: Sequence[int], **look) -> list[Look]:
    """What `scene` shows of the terrains `objects` at its frames `numbers`, which it goes through; `look` as of
    `request.gather`. Each frame is followed by the next one, if the scene has one."""
    from ..request.request import RENDER, gather

    requests, shown = {}, {}
    with paused():
        for number in sorted({n + step for n in numbers for step in (0, 1) if n + step <= max(scene.frame_end, n)}):
            scene.frame_set(number)
            for obj in objects:
                request = gather(obj, view_layer.depsgraph, RENDER, **look)
                # A view shows errors also where only metres are asked, which need none.
                views = request.views or gather(obj, view_layer.depsgraph, RENDER, criterion=Criterion(), **look).views
                requests[obj.name, number] = request
                shown[obj.name, number] = Frame(
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


def current_setting(request) -> Setting | None:
    """What of a request a sweep can vary: its error in pixels, else the one in metres, limits and interpolation."""
    criterion = request.criterion
    unit = unit_asked(criterion)
    if not unit:
        return None
    limits = criterion.max_depth, criterion.meshlet
    return Setting(unit, getattr(criterion, f"error_{unit}"), *limits, interpolation=request.interpolation)


def notes_on(criterion: Criterion) -> list[str]:
    """What of a criterion is no part of a sweep."""
    notes = []
    if not unit_asked(criterion):
        notes.append("The terrain asks for no error, so no setting is marked as the current one.")
    if criterion.error_px and criterion.error_m:
        notes.append("The terrain asks for metres too; the setting marked as current is its error in pixels alone.")
    if criterion.edge_px or criterion.area_px or criterion.max_triangles is not None:
        notes.append("Edge lengths, areas and limits of triangles that the terrain asks for are left out here.")
    return notes


def overview(heights: HeightField, resolution: tuple[int, int]) -> View:
    """From three quarters above, so far away that the whole terrain is in the picture."""
    lattice = heights.lattice
    x, y = (lattice.width - 1) * lattice.step_x, (lattice.height - 1) * lattice.step_y
    radius = 0.5 * math.hypot(x, y, heights.max_height - heights.min_height)
    middle = np.array([0.0, 0.0, 0.5 * (heights.max_height + heights.min_height)])
    half = math.atan(math.tan(math.radians(FOV_DEG) / 2) * min(resolution) / max(resolution))
    distance = radius / math.sin(half)
    eye = middle + distance * np.array(LOOK_FROM) / length(LOOK_FROM)
    return View.look(eye, middle, fov_deg=FOV_DEG, resolution=resolution, clip=(1e-3 * distance, 10 * distance))


def spread(first: int, last: int) -> list[int]:
    """At most SPREAD whole frames from first to last, evenly."""
    count = min(SPREAD, max(last, first) - first + 1)
    return sorted({round(n) for n in np.linspace(first, max(last, first), count)})


def slug(name: str) -> str:
    """The name as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "terrain"
