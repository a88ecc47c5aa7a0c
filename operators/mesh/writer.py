# SPDX-License-Identifier: GPL-3.0-or-later
"""The one writer: a Surface's arrays into a Blender mesh, in place.

Every array goes in as it is, in Blender's own dtypes. The edges come with it, so Blender computes none, and
`mesh.validate()` finds nothing to change. Materials and the mesh's other settings are the user's and stay.
"""

import numpy as np
import warp as wp

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import launch
from ...cbt_terrain.run.buffers import shared
from ...kernels.mesh import ingest
from . import memory as mesh_memory

UV_LAYER = "UVMap"
LEVEL_ATTRIBUTE = "terrain_level"
COLOUR_ATTRIBUTE = "terrain_overlay"
NORMAL_ATTRIBUTE = "custom_normal"  # a free normal per vertex, since Blender 4.5


def write_mesh(mesh, surface, *, smooth: bool = True, overlay=None) -> None:
    """Replace the geometry of `mesh` by `surface`.

    `surface`: positions, normals float32 [V, 3]; uv float32 [V, 2]; corner_verts, corner_edges int32 [3 T]; edges int32
    [E, 2]; level int32 [T]. `overlay`: an overlay.Overlay of its triangles, None for no colours. Raises TerrainError
    where the mesh cannot be written (edit mode, shape keys).
    """
    _check_writable(mesh)
    _write_geometry(mesh, surface)
    _write_shading(mesh, surface.normals, smooth)
    if overlay is not None:
        _write_overlay(mesh, overlay)
        _show_colours(mesh)
    mesh.update()


def _check_writable(mesh) -> None:
    if mesh.is_editmode:
        raise TerrainError(f"The mesh {mesh.name!r} is in edit mode; leave edit mode to update the terrain.")
    if mesh.shape_keys is not None:
        raise TerrainError(f"The mesh {mesh.name!r} has shape keys, which need a fixed topology; remove them.")


def _write_geometry(mesh, surface) -> None:
    """Everything but the shading."""
    triangles = len(surface.level)
    mesh.clear_geometry()
    mesh.vertices.add(len(surface.positions))
    mesh.edges.add(len(surface.edges))
    mesh.loops.add(3 * triangles)  # before the polygons, which take their last offset from it
    mesh.polygons.add(triangles)
    mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    mesh.attributes.new(LEVEL_ATTRIBUTE, "INT", "FACE")
    if not triangles:
        mesh.attributes["position"].data.foreach_set("vector", surface.positions.ravel())
        return
    offsets = mesh_memory.face_offsets(mesh)
    corner_uv = mesh_memory.vectors_2d(mesh.uv_layers[UV_LAYER].uv)
    copied = None
    if corner_uv is None:
        copied = np.empty((3 * triangles, 2), np.float32)
        corner_uv = shared(copied, wp.vec2f)

    def copy() -> None:
        _write_offsets(mesh, triangles, offsets)
        _copy_arrays(mesh.attributes, surface)

    def gather() -> None:
        inputs = [shared(surface.uv, wp.vec2f), shared(surface.corner_verts, wp.int32), corner_uv]
        launch.spread(ingest.corner_uv, 3 * triangles, inputs, step="mesh", threads=max(1, threads - 1))

    # A million triangles: 19 ms one after the other, 14.5 ms side by side. Only `copy` touches Blender's data, and it
    # starts with a kernel, which lets go of Python for `gather` to begin.
    threads = launch.default_threads()
    if threads > 1 and triangles >= launch.SLICE_ITEMS:
        launch.together([copy, gather])
    else:
        copy()
        gather()
    if copied is not None:
        mesh.uv_layers[UV_LAYER].uv.foreach_set("vector", copied.ravel())


def _write_offsets(mesh, triangles: int, offsets) -> None:
    """Every face begins three corners after the one before."""
    if offsets is None:
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * triangles, 3, dtype=np.int32))
    else:
        launch.spread(ingest.face_offsets, triangles, [offsets], step="mesh")


def _copy_arrays(attributes, surface) -> None:
    attributes["position"].data.foreach_set("vector", surface.positions.ravel())
    attributes[".edge_verts"].data.foreach_set("value", surface.edges.ravel())
    attributes[".corner_vert"].data.foreach_set("value", surface.corner_verts)
    attributes[".corner_edge"].data.foreach_set("value", surface.corner_edges)
    attributes[LEVEL_ATTRIBUTE].data.foreach_set("value", surface.level)


def _write_overlay(mesh, overlay) -> None:
    """Figures of the faces, and colours of the corners: Blender shows no colours of faces. As floats, because
    `foreach_set` converts colours of bytes one by one (a million triangles: 107 ms; floats 5 ms)."""
    for name, values in overlay.faces.items():
        mesh.attributes.new(name, "FLOAT", "FACE").data.foreach_set("value", values)
    colours = mesh.attributes.new(COLOUR_ATTRIBUTE, "FLOAT_COLOR", "CORNER")
    colours.data.foreach_set("color", overlay.corner_colours.ravel())


def _show_colours(mesh) -> None:
    """Make the overlay what Solid shading and materials show as the mesh's colour."""
    index = mesh.color_attributes.find(COLOUR_ATTRIBUTE)
    mesh.color_attributes.active_color_index = mesh.color_attributes.render_color_index = index


def _write_shading(mesh, normals: np.ndarray, smooth: bool) -> None:
    """Smooth with the given normals (float32 [V, 3]), or flat without any."""
    sharp = mesh.attributes.get("sharp_face")
    if smooth and sharp is not None:
        mesh.attributes.remove(sharp)
    if not smooth:
        sharp = sharp or mesh.attributes.new("sharp_face", "BOOLEAN", "FACE")
        sharp.data.foreach_set("value", np.ones(len(mesh.polygons), bool))
    if not smooth or not len(mesh.polygons):
        return
    normal = mesh.attributes.new(NORMAL_ATTRIBUTE, "FLOAT_VECTOR", "POINT")
    normal.data.foreach_set("vector", np.ascontiguousarray(normals, np.float32).ravel())
    if not mesh.has_custom_normals:  # this Blender only knows normals encoded per corner
        mesh.attributes.remove(normal)
        mesh.update()
        # As a list: of an array Blender takes each number by a call (a million triangles: 0.65 s; so 0.58 s).
        mesh.normals_split_custom_set_from_vertices(normals.tolist())
