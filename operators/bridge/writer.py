# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a Surface's arrays into a Blender mesh, in place.

Every array has Blender's dtype. The surface includes edges, so Blender computes none, and `mesh.validate()` changes
nothing. Materials and other settings of the mesh stay.
"""

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.mesh.attributes import NORMALS, TYPES, UV
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch
from ...cbt_terrain.run.buffers import shared

UV_LAYER = "UVMap"
COLOUR_ATTRIBUTE = "terrain_overlay"  # corner colours that Solid shading and materials show
NORMAL_ATTRIBUTE = "custom_normal"
# Since Blender 4.5 a mesh takes a free normal per vertex. Older versions encode normals per corner: 200 ms instead of
# 1 ms for 236,000 triangles.
STORES_VERTEX_NORMALS = bpy.app.version >= (4, 5, 0)


def new_child(terrain, name: str):
    """Create a mesh object as a child of a terrain, in its collections; return it."""
    child = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    child.parent = terrain
    for collection in terrain.users_collection:
        collection.objects.link(child)
    return child


def write_mesh(mesh, surface: Surface, *, smooth: bool = True, exact: bool = True) -> bool:
    """Replace the geometry and the attributes of a Blender mesh by those of `surface`.

    Its `uv` become the UV map, its `normals` the custom normals; other attributes keep their names. Raises TerrainError
    if the mesh cannot be written (edit mode, shape keys).

    Args:
        smooth: shade faces smoothly, with the surface's normals.
        exact: set those normals now, also where it is slow (Blender before 4.5).

    Returns whether the normals are still missing. Blender computes normals by itself until `write_normals` is
    called.
    """
    check_writable(mesh)
    _write_geometry(mesh, surface)
    _set_shading(mesh, smooth)
    is_postponed = smooth and not exact and not STORES_VERTEX_NORMALS
    if smooth and not is_postponed:
        write_normals(mesh, surface.normals)
    _show_colours(mesh)
    mesh.update()
    return is_postponed


def write_normals(mesh, normals: np.ndarray) -> None:
    """Set the custom normals of a smooth mesh that has none yet, float32 [V, 3]; nothing for one without faces."""
    if not len(mesh.polygons):
        return
    if STORES_VERTEX_NORMALS:
        normal = mesh.attributes.new(NORMAL_ATTRIBUTE, "FLOAT_VECTOR", "POINT")
        normal.data.foreach_set("vector", np.ascontiguousarray(normals, np.float32).ravel())
        return
    mesh.update()
    # a list takes 0.58 s per million triangles; Blender reads an array by a call per number, in 0.65 s
    mesh.normals_split_custom_set_from_vertices(normals.tolist())


def check_writable(mesh) -> None:
    """Raise TerrainError for a mesh in edit mode or with shape keys."""
    if mesh.is_editmode:
        raise TerrainError(f"The mesh {mesh.name!r} is in edit mode", fix="leave edit mode to update it")
    if mesh.shape_keys is not None:
        raise TerrainError(f"The mesh {mesh.name!r} has shape keys, which need a fixed topology", fix="remove them")


def add_attribute(mesh, name: str, kind: str, domain: str) -> None:
    """Add an attribute; kind, domain: Blender's names for its type and elements, as FLOAT and POINT.

    Raises TerrainError if Blender gives it another name.
    """
    if mesh.attributes.new(name, kind, domain).name != name:
        raise TerrainError(f"Blender cannot add an attribute with the name {name!r}", fix="give it another name")


def _write_geometry(mesh, surface: Surface) -> None:
    """Write vertices, edges, faces, UV map and attributes of a surface, but no normals.

    Raises TerrainError for the name of an attribute that Blender changes; the mesh then has elements without values.
    """
    from ...kernels import wp
    from ...kernels.mesh import ingest
    from . import memory as mesh_memory

    triangles = len(surface.triangles)
    named = {name: item for name, item in surface.attributes.items() if name not in (NORMALS, UV)}
    mesh.clear_geometry()
    mesh.vertices.add(len(surface.positions))
    mesh.edges.add(len(surface.edges))
    mesh.loops.add(3 * triangles)  # before the polygons, which derive their last offset from it
    mesh.polygons.add(triangles)
    mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    for name, attribute in named.items():  # add all before writing: Blender may move existing ones
        add_attribute(mesh, name, TYPES[attribute.kind][0], attribute.domain)
    if not triangles:
        mesh.attributes["position"].data.foreach_set("vector", surface.positions.ravel())
        return
    # Warp arrays over Blender's memory: the first corner of each face and the UV of each corner. Both are None in a
    # Blender whose memory cannot be written in place; then arrays are made here and copied.
    offsets = mesh_memory.array_in_place(mesh.polygons, wp.int32)
    corner_uv = mesh_memory.array_in_place(mesh.uv_layers[UV_LAYER].uv, wp.vec2f)
    copied = None
    if corner_uv is None:
        copied = np.empty((3 * triangles, 2), np.float32)
        corner_uv = shared(copied, wp.vec2f)  # a Warp array over the same memory

    def copy() -> None:
        """Copy all arrays except the UV map into Blender's memory."""
        _write_offsets(mesh, triangles, offsets)
        _copy_arrays(mesh.attributes, surface)
        for name, attribute in named.items():
            mesh.attributes[name].data.foreach_set(TYPES[attribute.kind][1], attribute.array.ravel())

    def gather() -> None:
        """Write the UV of each face corner from the UV of its vertex."""
        inputs = [shared(surface.uv, wp.vec2f), shared(surface.corner_verts, wp.int32), corner_uv]
        launch.spread(ingest.corner_uv, 3 * triangles, inputs, step="mesh", threads=max(1, threads - 1))

    # A million triangles take 19 ms in sequence and 14.5 ms in parallel. Only `copy` accesses Blender's data. It starts
    # with a kernel, which releases the GIL so that `gather` can start.
    threads = launch.default_threads()
    if threads > 1 and triangles >= launch.SLICE_ITEMS:
        launch.together([copy, gather])
    else:
        copy()
        gather()
    if copied is not None:
        mesh.uv_layers[UV_LAYER].uv.foreach_set("vector", copied.ravel())


def _write_offsets(mesh, triangles: int, offsets) -> None:
    """Write the number of the first corner of each face: three corners apart.

    offsets: Warp array over Blender's memory, None to use `foreach_set`.
    """
    from ...kernels.mesh import ingest

    if offsets is None:
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * triangles, 3, dtype=np.int32))
    else:
        launch.spread(ingest.face_offsets, triangles, [offsets], step="mesh")


def _copy_arrays(attributes, surface: Surface) -> None:
    """Copy points and topology into Blender's built-in attributes."""
    attributes["position"].data.foreach_set("vector", surface.positions.ravel())
    attributes[".edge_verts"].data.foreach_set("value", surface.edges.ravel())
    attributes[".corner_vert"].data.foreach_set("value", surface.corner_verts)
    attributes[".corner_edge"].data.foreach_set("value", surface.corner_edges)


def _show_colours(mesh) -> None:
    """Make the overlay, if there is one, the active colour of the mesh."""
    index = mesh.color_attributes.find(COLOUR_ATTRIBUTE)
    if index >= 0:
        mesh.color_attributes.active_color_index = mesh.color_attributes.render_color_index = index


def _set_shading(mesh, smooth: bool) -> None:
    """Set all faces to smooth or flat shading."""
    sharp = mesh.attributes.get("sharp_face")
    if smooth and sharp is not None:
        mesh.attributes.remove(sharp)
    if not smooth:
        sharp = sharp or mesh.attributes.new("sharp_face", "BOOLEAN", "FACE")
        sharp.data.foreach_set("value", np.ones(len(mesh.polygons), bool))
