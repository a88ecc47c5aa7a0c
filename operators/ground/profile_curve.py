# SPDX-License-Identifier: GPL-3.0-or-later
"""Profile: the terrain along a curve, as a curve on the ground, a table and a picture."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.georeference import to_crs
from ...cbt_terrain.run.partial_files import written_beside
from ..bridge.scene_origin import is_in_degrees
from ..bridge.scene_paths import absolute_path
from ..maps.properties import PATH_OPTIONS
from ..session.polls import cancelled_by_errors
from ..text import profile_plot
from ..text.numbers import length_text
from .chosen import GroundOperator, terrain_at

SUFFIXES = ".csv", ".svg"


class ProfileCurve(GroundOperator, bpy.types.Operator):
    """Add a copy of the selected curve that follows the ground. With a file name, also write its heights as a table
    (CSV) and a picture (SVG)"""

    bl_idname = "adaptive_terrain.profile"
    bl_label = "Profile"
    bl_options = {"REGISTER", "UNDO"}

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between two points of the new curve, in metres; 0: a point wherever it crosses a line of "
        "the height map",
        min=0.0, unit="LENGTH",
    )  # fmt: skip
    filepath: bpy.props.StringProperty(
        name="File",
        description="File of the table; the picture is written beside it with the ending .svg. Empty: no files",
        subtype="FILE_PATH", options=PATH_OPTIONS,
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        """Return whether there is ground and a selected curve; otherwise set the reason that Blender shows."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Select a curve over the terrain")
        return bool(_chosen_curves(context))

    @cancelled_by_errors
    def execute(self, context):
        """Create a curve on the ground for the chosen curve, and write the files if they are named."""
        depsgraph = context.evaluated_depsgraph_get()
        for curve in _chosen_curves(context):  # exactly one, since `poll` requires it
            lines = lines_of(curve, depsgraph)
            _, ground = terrain_at(context, np.concatenate(lines), f"the curve {curve.name!r}", depsgraph)
            found = [along_line(ground, line, self.spacing or None) for line in lines]
            if not any(np.isfinite(points).all(axis=1).any() for _, points in found):
                raise TerrainError(
                    f"There is no ground below the curve {curve.name!r}, which crosses holes or is outside",
                    fix="move it over the terrain",
                )
            files = self._write(curve.name, found, ground) if self.filepath else []
            obj = _new_curve(context, f"{curve.name} Profile", [points for _, points in found])
        heights = np.concatenate([points[:, 2] for _, points in found])
        low, high = (length_text(float(value)) for value in (np.nanmin(heights), np.nanmax(heights)))
        written = f"; written: {', '.join(files)}" if files else ""
        self.report({"INFO"}, f"{obj.name}: {len(heights):,} points, from {low} to {high}{written}")
        return {"FINISHED"}

    def _write(self, name: str, found, ground) -> list[str]:
        """Write the table and the picture of a profile; return the file names.

        name: title of the picture. found: for each spline the distances along it, float64 [n], and the points on the
        ground, [n, 3], metres; several splines get numbered files. ground: WorldGround of its terrain. Raises
        TerrainError for a path without a name or a file that cannot be written.
        """
        base = Path(absolute_path(self.filepath))
        base = base.with_suffix("") if base.suffix.lower() in SUFFIXES else base
        if not base.name:
            raise TerrainError(f"The file {self.filepath!r} has no name", expected="one, such as //profile.csv")
        files = []
        for number, (along, points) in enumerate(found):
            numbered = base if len(found) == 1 else base.with_name(f"{base.name}_{number + 1}")
            texts = profile_csv(along, points, ground), profile_plot.draw(along, points[:, 2], name)
            for suffix, content in zip(SUFFIXES, texts, strict=True):
                path = numbered.with_name(numbered.name + suffix)
                try:
                    with written_beside(path) as partial:
                        Path(partial).write_text(content, encoding="utf-8")
                except OSError as reason:
                    cause = reason.strerror or reason
                    raise TerrainError(f"{path} cannot be written ({cause})", fix="choose another folder") from None
                files.append(path.name)
        return files


def _chosen_curves(context) -> list:
    """Return the active curve if it is selected, else the first selected curve, as a list; [] without one."""
    found = [obj for obj in context.selected_objects if obj.type == "CURVE"]
    return [context.object] if context.object in found else found[:1]


def lines_of(curve, depsgraph) -> list[np.ndarray]:
    """Return the splines of a curve object, at its resolution, as lines in the world, float64 [n, 3] each.

    A copy without bevel and extrusion is converted to a mesh of edges. Raises TerrainError if there is no line.
    """
    plain = curve.data.copy()
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
        raise TerrainError(f"The curve {curve.name!r} has no line", expected="a spline of at least two points")
    return lines


def _chains(pairs) -> list[list[int]]:
    """Join edges to lines of vertices; the line of a cyclic spline ends with its first vertex.

    pairs: vertices of each edge. A spline's vertices are consecutive, and a cyclic one has an edge between its ends.
    """
    lines = []
    # Sorted by the lower vertex. Of two edges with the same one, that to the next vertex comes before the closing edge
    # of a cyclic spline, which neither branch takes.
    for a, b in sorted(pairs, key=lambda pair: (min(pair), max(pair) - min(pair) != 1)):
        low, high = min(a, b), max(a, b)
        if lines and lines[-1][-1] == low:
            lines[-1].append(high)
        elif high == low + 1:
            lines.append([low, high])
    edges = {(min(pair), max(pair)) for pair in pairs}
    for line in lines:
        if len(line) > 2 and (line[0], line[-1]) in edges:
            line.append(line[0])
    return lines


def along_line(ground, line: np.ndarray, spacing: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the profile of a line on the ground: distances from its start and points of the world.

    Distances are horizontal, float64 [n] metres; points are float64 [n, 3], with height NaN without ground.

    Args:
        ground: WorldGround of the terrain.
        line: float64 [n, 3], points of the world.
        spacing: metres between points; None for one at every cell border that the line crosses.
    """
    from ...cbt_terrain.query.ground import profile

    found = profile(ground.field, ground.to_local(line)[:, :2], spacing, **ground.scale_and_offset)
    known = np.isfinite(found.heights)
    points = ground.to_world(np.c_[found.places, np.where(known, found.heights, 0.0)])
    points[~known, 2] = np.nan
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)]), points


def profile_csv(along: np.ndarray, points: np.ndarray, ground) -> str:
    """Return a CSV of distance, x, y and height in metres of the world, with an empty height without ground.

    Two more columns have the coordinates in the system of the terrain, if it has one. along, points: result of
    `along_line` for `ground`.
    """
    raster = ground.field.raster
    names, coordinates = "distance_m,x_m,y_m,height_m", np.empty((len(points), 0))
    if raster.crs and raster.known_place is not None:
        names += ",longitude,latitude" if is_in_degrees(raster.known_place) else ",easting,northing"
        coordinates = to_crs(raster.known_place, ground.to_local(np.nan_to_num(points))[:, :2])
    rows = [names]
    for distance, (x, y, z), more in zip(along.tolist(), points.tolist(), coordinates.tolist(), strict=True):
        height = "" if np.isnan(z) else f"{z:.9g}"
        rows.append(",".join((f"{distance:.6g}", f"{x:.9g}", f"{y:.9g}", height, *(f"{c:.12g}" for c in more))))
    return "\n".join(rows) + "\n"


def _new_curve(context, name: str, lines: list[np.ndarray]):
    """Add a curve object through points of the world, split where there is no height; its origin is the first point.

    lines: float64 [n, 3] each, with height NaN without ground; one height at least is known. Single points are left
    out.
    """
    data = bpy.data.curves.new(name, "CURVE")
    data.dimensions = "3D"
    first = next(p for line in lines for p in line if np.isfinite(p).all())
    for line in lines:
        for begin, end in profile_plot.runs_of(np.isfinite(line[:, 2])):
            if end - begin < 2:
                continue
            spline = data.splines.new("POLY")
            spline.points.add(end - begin - 1)  # a new spline has one point
            points = np.c_[line[begin:end] - first, np.ones(end - begin)]  # with weights of 1
            spline.points.foreach_set("co", points.astype(np.float32).ravel())
    obj = bpy.data.objects.new(name, data)
    obj.location = Vector(first.tolist())
    context.collection.objects.link(obj)
    return obj
