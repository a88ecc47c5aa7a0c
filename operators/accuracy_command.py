# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain accuracy`: what accuracy costs on the terrains of a store or a scene, measured and written down."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..cbt_terrain.camera_path import read_camera_path
from ..cbt_terrain.criterion import Criterion, unit_asked
from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.heightfield import HeightField
from ..cbt_terrain.store import open_store
from ..cbt_terrain.sweep import Frame, Row, Setting, settings_for, sweep
from ..cbt_terrain.view import View
from . import accuracy_page
from .console import Progress
from .exporting import check_target, make_folder, write_text, write_texts
from .frame_sources import SceneFrames, file_name, handlers_off, need_bpy
from .machine import machine

# Frames of a camera path that are measured where none are named: so many, evenly spread.
SPREAD = 4
# The view where none is given: from the south-west, a third of a right angle above the horizon.
LOOK_FROM, FOV_DEG = (-0.6, -0.65, 0.47), 50.0
FILES = ("accuracy.csv", "accuracy.json", "accuracy.md", "index.html")
PROBE = "accuracy.tmp"


@dataclass
class Subject:
    """One terrain that is measured. `numbers`: of the frames. `seen`: from where, in words. `current`: the setting that
    the scene (or an export) uses, None where it asks for no error. `base`: where guard band and culling come from."""

    name: str
    heights: HeightField
    frames: list[Frame]
    numbers: list[int]
    seen: str
    current: Setting | None
    base: Criterion = field(default_factory=Criterion)
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def settings(self) -> list[Setting]:
        """A whole sweep, and the current setting if that is none of it."""
        settings = settings_for(self.heights, self.frames[0])
        return settings if self.current is None or self.current in settings else [self.current, *settings]


def run(subjects: list[Subject], out: Path, show_progress: bool | None = None) -> None:
    """Measure every subject and write FILES and the plots into the folder `out`, all at the end.

    Raises TerrainError where something cannot be written, and at the very end where a measured error passes its bound.
    """
    make_folder(out)
    for name in FILES:
        check_target(out / name)
    write_text(out / PROBE, "")  # better now than after minutes of measuring
    (out / PROBE).unlink()
    measure(subjects, show_progress)
    write_texts(out, accuracy_page.files(subjects, machine()))
    print(f"{out / 'index.html'} shows it")
    check_bounds(subjects)


def check_bounds(subjects: list[Subject]) -> None:
    """Raise TerrainError where a measured error passes its bound."""
    if broken := [(subject, row) for subject in subjects for row in subject.rows if not row.error <= row.bound]:
        subject, row = broken[0]
        raise TerrainError(
            f"The bound does not hold in {len(broken)} row{'s' * (len(broken) > 1)}, first of {subject.name} at "
            f"{accuracy_page.label(row.setting)}: bounded by {row.bound:.9g} {row.setting.unit}, measured "
            f"{row.error:.9g}; please report it with accuracy.json."
        )


def measure(subjects: list[Subject], show_progress: bool | None = None) -> None:
    """Fill in the rows of every subject, a line each on stdout and a bar on stderr."""
    bar = Progress(len(subjects), "accuracy", show_progress)
    try:
        with mesh_writer() as (write, note):
            for done, subject in enumerate(subjects):
                subject.notes += [note] if note else []
                subject.rows = sweep(
                    subject.heights,
                    subject.settings,
                    subject.frames,
                    base=subject.base,
                    write=write,
                    on_row=lambda row, name=subject.name: bar.say(f"{name}, {accuracy_page.row_line(row)}"),
                    on_progress=lambda fraction, done=done: bar.to(done + fraction),
                )
    finally:
        bar.close()


@contextmanager
def mesh_writer() -> Iterator[tuple[Callable | None, str]]:
    """What writes a surface into a Blender mesh of its own, and ""; or None and why, where Blender is missing."""
    try:
        bpy = need_bpy("Writing a mesh")
    except TerrainError as reason:
        yield None, f"Writing the mesh into Blender was not measured. {reason}"
        return
    from .mesh_writer import write_mesh

    mesh = bpy.data.meshes.new("accuracy")
    try:
        yield lambda surface: write_mesh(mesh, surface), ""
    finally:
        bpy.data.meshes.remove(mesh)


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

    from . import session
    from .request import RENDER, gather

    scene, looks = source.scene, {}
    numbers = list(frames or [scene.frame_current])

    def look(obj, **criterion):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return gather(obj, depsgraph, RENDER, camera=source.camera, resolution=resolution, **criterion)

    with handlers_off():
        for number in sorted({n + step for n in numbers for step in (0, 1) if n + step <= max(scene.frame_end, n)}):
            scene.frame_set(number)
            for obj in source.objects:
                request = look(obj)
                views = request.views or look(obj, criterion=Criterion()).views
                frame = Frame(views, request.placement, request.vertical_scale, request.vertical_offset)
                looks[obj.name, number] = request, frame
    subjects = []
    for obj in source.objects:
        request, first = looks[obj.name, numbers[0]]
        found = [(looks[obj.name, n][1], looks.get((obj.name, n + 1), (None, None))[1]) for n in numbers]
        shown = [Frame(f.views, *f.heights, after=after) for f, after in found]
        size = " x ".join(f"{pixels:g}" for pixels in first.views[0].resolution)
        seen = f"through the camera of {Path(blend).name}, {size} pixels"
        heights, current = session.field_of(request), current_setting(request)
        subjects.append(Subject(file_name(obj), heights, shown, numbers, seen, current, request.criterion))
        subjects[-1].notes += notes_on(request.criterion)
    return subjects


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
    eye = middle + distance * np.array(LOOK_FROM) / np.linalg.norm(LOOK_FROM)
    return View.look(eye, middle, fov_deg=FOV_DEG, resolution=resolution, clip=(1e-3 * distance, 10 * distance))


def spread(first: int, last: int) -> list[int]:
    """At most SPREAD whole frames from first to last, evenly."""
    count = min(SPREAD, max(last, first) - first + 1)
    return sorted({round(n) for n in np.linspace(first, max(last, first), count)})


def slug(name: str) -> str:
    """The name as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_").lower() or "terrain"
