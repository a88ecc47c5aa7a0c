# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a scatter stands still, beside Blender's own distribution of points on the same meshes."""

from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.scatter.points import ScatterPoints, ScatterRequest, place_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.blender import need_bpy
from adaptive_terrain.operators.bridge.nodes import Nodes
from adaptive_terrain.operators.text.page_blocks import Heading, Table, Text

FRAMES, STEP = 200, 2.0  # metres a frame
COMPARED = 4  # frames for Blender's own points
SAME_PLACE = 0.02  # metres
RESOLUTION = (1920, 1080)
SCATTER = Scatter(spacing=4.0, full_until=800.0)
# As many points as the scatter has, about.
METHODS = {"RANDOM": {"Density": 0.002}, "POISSON": {"Distance Min": 15.0, "Density Max": 0.02}}


def view(frame: int) -> View:
    """Over the built-in island."""
    ahead = np.array([0.8, 0.6, 0.0])
    eye = np.array([-2800.0, -2400.0, 420.0]) + STEP * frame * ahead
    return View.look(eye, eye + 1000 * ahead - [0, 0, 120], fov_deg=50, resolution=RESOLUTION, clip=(1, 1e6))


def scatter_section(folder: Path) -> list:
    """Return the section about scatters that stand still."""
    import_source(ImportSettings(source="island", size=2049), folder / "island.store")
    field = open_store(folder / "island.store")
    counts, moved, sudden, changed = stillness(field)
    rows = [["Adaptive Scatter", f"{counts:,.0f}", f"{100 * (1 - moved):.4g} %"]]
    need_bpy("Blender's own distribution of points")
    rows += [
        [f"Distribute Points on Faces, {name}", f"{n:,.0f}", f"{100 * share:.2g} %"]
        for name, n, share in by_blender(field)
    ]
    return [
        Heading("Scatter that stands still"),
        Text(
            "*Distribute Points on Faces* numbers its points by the mesh's triangles. On a mesh that changes with the "
            "camera nearly every point is another one in the next frame, and a forest boils. The points of *Add "
            "Scatter* are places of the ground: which of them are there follows from the distance alone, they grow "
            "from nothing, and none moves."
        ),
        Text(f"Points of one frame that are at the same place, within {100 * SAME_PLACE:g} cm, in the next one:"),
        Table(["", "points in view", "stay"], rows),
        Text(
            f"Over {FRAMES} frames of {STEP:g} m: {moved:g} of the points that stayed in view moved; the largest size "
            f"at which a point in the middle of the view appeared or went was {sudden:.3g} of its full size; the "
            f"largest change of size from frame to frame was {changed:.3g}."
        ),
    ]


def stillness(field) -> tuple[float, float, float, float]:
    """Return four figures of a scatter in a flight.

    The mean number of points; the share of the points in two successive frames that moved; the largest size, relative
    to full size, of a point that appeared or vanished well inside both frames; and the largest change of size.
    """
    counts, moved, both_frames, sudden, changed, before = [], 0, 0, 0.0, 0.0, None
    history = FrameHistory()
    for frame in range(FRAMES):
        points = place_points(field, ScatterRequest(SCATTER, [view(frame)]), history)
        order = np.argsort(points.id)
        points = points.only(order)
        counts.append(len(points))
        if before is not None:
            _, here, there = np.intersect1d(points.id, before.id, return_indices=True)
            moved += int((points.positions[here] != before.positions[there]).any(axis=1).sum())
            both_frames += len(here)
            changed = max(changed, float(np.abs(points.size[here] - before.size[there]).max(initial=0)))
            sudden = max(sudden, largest_alone(points, here, frame), largest_alone(before, there, frame - 1))
        before = points
    return float(np.mean(counts)), moved / max(1, both_frames), sudden, changed


def largest_alone(points: ScatterPoints, shared: np.ndarray, frame: int) -> float:
    """Return the largest size of points outside `shared` in the middle half of both frames' pictures."""
    alone = np.setdiff1d(np.arange(len(points)), shared)
    size, where = points.size[alone], points.positions[alone].astype(np.float64)
    for number in (frame, frame + 1):
        seen = view(number)
        clip = np.c_[where, np.ones(len(where))] @ (seen.projection @ seen.world_to_camera).T
        middle = (np.abs(clip[:, :2]) < 0.5 * clip[:, 3:]).all(axis=1) & (clip[:, 3] > 0)
        size, where = size[middle], where[middle]
    return float(size.max(initial=0.0))


def by_blender(field):
    """Per method of Blender's own node: its name, how many points there are, and the part of them that stays."""
    import bpy

    terrain, mesh = Terrain(field), bpy.data.meshes.new("Ground")
    obj = bpy.data.objects.new("Ground", mesh)
    bpy.context.scene.collection.objects.link(obj)
    modifier = obj.modifiers.new("Points", "NODES")
    for method, inputs in METHODS.items():
        modifier.node_group, before, shares, counts = _distribution(method, inputs), None, [], []
        for frame in range(COMPARED):
            surface = terrain.update(Criterion(error_px=1.0), [view(frame)]).surface
            mesh.clear_geometry()
            mesh.from_pydata(surface.positions.tolist(), [], surface.triangles.tolist())
            obj.update_tag()
            bpy.context.view_layer.update()
            found = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
            places = np.empty(3 * len(found), np.float32)
            found.foreach_get("co", places)
            cells = np.rint(places.reshape(-1, 3)[:, :2].astype(np.float64) / SAME_PLACE).astype(np.int64)
            keys = cells[:, 0] << 32 ^ (cells[:, 1] & 0xFFFFFFFF)
            if before is not None:
                shares.append(float(np.isin(before, keys).mean()))
            before = keys
            counts.append(len(keys))
        yield method.lower(), float(np.mean(counts)), float(np.mean(shares))
    bpy.data.objects.remove(obj)


def _distribution(method: str, inputs: dict[str, float]):
    import bpy

    tree = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = Nodes(tree)
    ground = nodes.add("NodeGroupInput").outputs[0]
    spread = nodes.add("GeometryNodeDistributePointsOnFaces", {"Mesh": ground, **inputs}, distribute_method=method)
    vertices = nodes.add("GeometryNodePointsToVertices", {0: spread.outputs["Points"]})
    nodes.add("NodeGroupOutput", {0: vertices.outputs[0]})
    return tree
