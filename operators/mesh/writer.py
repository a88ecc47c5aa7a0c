# SPDX-License-Identifier: GPL-3.0-or-later
"""The one writer: a Surface's arrays into a Blender mesh, in place.

Every array goes in as it is, in Blender's own dtypes. The edges come with it, so Blender computes none, and
`mesh.validate()` finds nothing to change. Materials and the mesh's other settings are the user's and stay.
"""

import numpy as np
import warp as wp

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.mesh.attributes import NORMALS, TYPES, UV
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch
from ...cbt_terrain.run.buffers import shared
from ...kernels.mesh import ingest
from . import memory as mesh_memory

UV_LAYER = "UVMap"
COLOUR_ATTRIBUTE = "terrain_overlay"  # of the corners; where a surface has it, Solid shading and materials show it
NORMAL_ATTRIBUTE = "custom_normal"  # a free normal per vertex, since Blender 4.5


def write_mesh(mesh, surface: Surface, *, smooth: bool = True) -> None:
    """Replace the geometry and the attributes of `mesh` by those of `surface`.

    Its `uv` become the UV map, its `normals` the custom normals; all others keep their names. Raises TerrainError where
    the mesh cannot be written (edit mode, shape keys).
    """
    _check_writable(mesh)
    _write_geometry(mesh, surface)
    _write_shading(mesh, surface.normals, smooth)
    _show_colours(mesh)
    mesh.update()


def _check_writable(mesh) -> None:
    if mesh.is_editmode:
        raise TerrainError(f"The mesh {mesh.name!r} is in edit mode; leave edit mode to update the terrain.")
    if mesh.shape_keys is not None:
        raise TerrainError(f"The mesh {mesh.name!r} has shape keys, which need a fixed topology; remove them.")


def _write_geometry(mesh, surface: Surface) -> None:
    """Everything but the shading."""
    triangles = len(surface.triangles)
    named = {name: item for name, item in surface.attributes.items() if name not in (NORMALS, UV)}
    mesh.clear_geometry()
    mesh.vertices.add(len(surface.positions))
    mesh.edges.add(len(surface.edges))
    mesh.loops.add(3 * triangles)  # before the polygons, which take their last offset from it
    mesh.polygons.add(triangles)
    mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    for name, attribute in named.items():  # all before one is written: Blender may move what it has
        if mesh.attributes.new(name, TYPES[attribute.kind][0], attribute.domain).name != name:
            raise TerrainError(f"Blender has no room for an attribute of the name {name!r}: give it another name.")
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
        for name, attribute in named.items():
            mesh.attributes[name].data.foreach_set(TYPES[attribute.kind][1], attribute.array.ravel())

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


def _copy_arrays(own, surface: Surface) -> None:
    """Points and topology, which Blender keeps as attributes of its own."""
    own["position"].data.foreach_set("vector", surface.positions.ravel())
    own[".edge_verts"].data.foreach_set("value", surface.edges.ravel())
    own[".corner_vert"].data.foreach_set("value", surface.corner_verts)
    own[".corner_edge"].data.foreach_set("value", surface.corner_edges)


def _show_colours(mesh) -> None:
    """Make the overlay, where there is one, what Solid shading and materials show as the mesh's colour."""
    index = mesh.color_attributes.find(COLOUR_ATTRIBUTE)
    if index >= 0:
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
