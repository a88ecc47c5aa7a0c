# SPDX-License-Identifier: GPL-3.0-or-later
"""Profile: the terrain along a curve, as a curve on the ground, a table and a picture."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.query.ground import profile
from ...cbt_terrain.run.partial_files import written_beside
from ..properties.scene_paths import absolute_path
from ..text import profile_plot
from ..text.numbers import length_text
from . import world_ground
from .chosen import active_terrain, has_ground

SUFFIXES = ".csv", ".svg"
PATH_OPTIONS = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()


class ProfileCurve(bpy.types.Operator):
    """Lay a selected curve on the terrain: a new curve through every cell that it crosses, its figures as a table
    (CSV) and its picture (SVG) where files are named. The vertical is the terrain's own"""

    bl_idname = "adaptive_terrain.profile"
    bl_label = "Profile"
    bl_options = {"REGISTER", "UNDO"}

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Metres of the terrain between two points; 0: wherever the curve crosses a line of samples",
        min=0.0, unit="LENGTH",
    )  # fmt: skip
    filepath: bpy.props.StringProperty(
        name="File",
        description="Where the table goes, and with the suffix .svg beside it the picture; empty: no files",
        subtype="FILE_PATH", options=PATH_OPTIONS,
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        if not has_ground(cls, context):
            return False
        cls.poll_message_set("Select a curve over the terrain")
        return bool(_curves(context))

    def execute(self, context):
        depsgraph = context.evaluated_depsgraph_get()
        try:
            for curve in _curves(context):
                lines = lines_of(curve, depsgraph)
                ground = _ground_of(context, curve, lines, depsgraph)
                found = [along_line(ground, line, self.spacing or None) for line in lines]
                if not any(np.isfinite(points).all(axis=1).any() for _, points in found):
                    raise TerrainError(
                        f"There is no ground below the curve {curve.name!r}: it crosses holes or lies beside it."
                    )
                files = self._write(curve.name, found) if self.filepath else []
                obj = _new_curve(context, f"{curve.name} Profile", [points for _, points in found])
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        heights = np.concatenate([points[:, 2] for _, points in found])
        low, high = (length_text(float(value)) for value in (np.nanmin(heights), np.nanmax(heights)))
        written = f"; written: {', '.join(files)}" if files else ""
        self.report({"INFO"}, f"{obj.name}: {len(heights):,} points, from {low} to {high}{written}")
        return {"FINISHED"}

    def _write(self, name: str, found) -> list[str]:
        """Of several splines each in files of their own number."""
        base = Path(absolute_path(self.filepath))
        base = base.with_suffix("") if base.suffix.lower() in SUFFIXES else base
        if not base.name:
            raise TerrainError(f"The file {self.filepath!r} has no name; expected one, such as //profile.csv.")
        files = []
        for number, (along, points) in enumerate(found):
            own = base if len(found) == 1 else base.with_name(f"{base.name}_{number + 1}")
            texts = table(along, points), profile_plot.draw(along, points[:, 2], name)
            for suffix, content in zip(SUFFIXES, texts, strict=True):
                path = own.with_name(own.name + suffix)
                try:
                    with written_beside(path) as partial:
                        Path(partial).write_text(content, encoding="utf-8")
                except OSError as reason:
                    said = reason.strerror or reason
                    raise TerrainError(f"{path} cannot be written ({said}): choose another folder.") from None
                files.append(path.name)
        return files


def _curves(context) -> list:
    """The active one of the selected curves, or the first."""
    found = [obj for obj in context.selected_objects if obj.type == "CURVE"]
    return [context.object] if context.object in found else found[:1]


def lines_of(curve, depsgraph) -> list[np.ndarray]:
    """The splines of a curve object as lines through the world, float64 [n, 3] each, as fine as the curve draws them.

    Raises TerrainError without one.
    """
    plain = curve.data.copy()  # without what makes a surface of it
    plain.bevel_depth = plain.extrude = 0.0
    plain.bevel_object, plain.bevel_mode, plain.dimensions = None, "ROUND", "3D"
    stand_in = bpy.data.objects.new("Profile", plain)
    matrix = curve.evaluated_get(depsgraph).matrix_world
    try:
        mesh = stand_in.to_mesh()
        points = [matrix @ vertex.co for vertex in mesh.vertices]
        pairs = [tuple(edge.vertices) for edge in mesh.edges]
        stand_in.to_mesh_clear()
    finally:
        bpy.data.objects.remove(stand_in)
        bpy.data.curves.remove(plain)
    lines = [np.array([points[n] for n in line], np.float64) for line in _chains(pairs)]
    if not lines:
        raise TerrainError(f"The curve {curve.name!r} has no line; expected a spline of two points at least.")
    return lines


def _chains(pairs) -> list[list[int]]:
    """Edges as lines of vertices: a spline's edges follow each other; of a cyclic one the last leads to the first."""
    lines = []
    for a, b in sorted(pairs, key=lambda pair: (min(pair), max(pair) - min(pair) != 1)):
        low, high = min(a, b), max(a, b)
        if lines and lines[-1][-1] == low:
            lines[-1].append(high)
        elif high == low + 1:
            lines.append([low, high])
    ends = {(min(pair), max(pair)) for pair in pairs}
    for line in lines:
        if len(line) > 2 and (line[0], line[-1]) in ends:
            line.append(line[0])
    return lines


def _ground_of(context, curve, lines, depsgraph) -> world_ground.Ground:
    """The active terrain if it is selected, else the one below the most points of a curve. Raises TerrainError."""
    terrain = active_terrain(context)
    if terrain is not None:
        return world_ground.ground_of(terrain, depsgraph)
    found = world_ground.grounds_of(context.scene, depsgraph)
    which = world_ground.below(found, np.concatenate(lines)).which
    if not (which >= 0).any():
        raise TerrainError(f"There is no terrain above or below the curve {curve.name!r}; move it over one.")
    return found[np.bincount(which[which >= 0]).argmax()]


def along_line(ground, line: np.ndarray, spacing: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Metres of the world's plan from the line's begin, float64 [n], and points of the world, float64 [n, 3]; their
    heights are NaN without ground."""
    own = ground.to_own(line)[:, :2]
    found = profile(ground.field, own, spacing, **ground.heights)
    known = np.isfinite(found.heights)
    points = ground.to_world(np.c_[found.places, np.where(known, found.heights, 0.0)])
    points[~known, 2] = np.nan
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)]), points


def table(along: np.ndarray, points: np.ndarray) -> str:
    """CSV: metres along the line, and x, y and height in the world; no height where there is no ground."""
    rows = ["distance_m,x_m,y_m,height_m"]
    for distance, (x, y, z) in zip(along.tolist(), points.tolist(), strict=True):
        rows.append(f"{distance:.6g},{x:.9g},{y:.9g},{'' if z != z else f'{z:.9g}'}")
    return "\n".join(rows) + "\n"


def _new_curve(context, name: str, lines: list[np.ndarray]):
    """A curve object through points of the world, one of which has a height; in parts where others have none."""
    data = bpy.data.curves.new(name, "CURVE")
    data.dimensions = "3D"
    first = next(p for line in lines for p in line if np.isfinite(p).all())
    for line in lines:
        ends = np.flatnonzero(np.diff(np.r_[False, np.isfinite(line[:, 2]), False].astype(np.int8)))
        for begin, end in ends.reshape(-1, 2):
            if end - begin < 2:
                continue
            spline = data.splines.new("POLY")
            spline.points.add(end - begin - 1)
            places = np.c_[line[begin:end] - first, np.ones(end - begin)]
            spline.points.foreach_set("co", places.astype(np.float32).ravel())
    obj = bpy.data.objects.new(name, data)
    obj.location = Vector(first.tolist())
    context.collection.objects.link(obj)
    return obj


register, unregister = bpy.utils.register_classes_factory((ProfileCurve,))
