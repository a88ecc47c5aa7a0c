# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's mesh arrays, written in place after a probe has confirmed their memory layout.

For a million triangles, `attribute.data.foreach_set` with equal dtypes is a memcpy (0.7 to 1.5 ms for each of
`position`, `.edge_verts`, `.corner_vert`, `.corner_edge`), which cannot be improved. But
`polygons.foreach_set("loop_start")` calls a function per face (57 ms; in place 0.8 ms), and texture coordinates must be
gathered for the corners (13 ms in numpy plus 3 ms to copy; in place 5 ms, parallel to the other copies).
"""

from functools import cache

import bpy
import numpy as np
import warp as wp

# Two triangles with different, exact corner coordinates.
TRIANGLES = [(0, 1, 2), (0, 2, 3)]
OFFSETS = np.array([0, 3], np.int32)
CORNERS = np.arange(12, dtype=np.float32).reshape(6, 2) / 16


def array_in_place(items, dtype) -> wp.array | None:
    """Return a Warp array over the polygons (int32) or a float2 attribute (vec2f) of a new mesh; None to use
    `foreach_set`. Write it before the mesh's geometry changes.
    """
    return _array_over(items, dtype) if writable_in_place() else None


@cache
def writable_in_place() -> bool:
    """Return whether this Blender's meshes can be written in place, by one test on a mesh of two triangles.

    The answer is cached. Each step is safe if the step before has passed: the probe reads only between the addresses
    that Blender gave for its items, and writes only where it has read the values of `foreach_set`.
    """
    mesh = bpy.data.meshes.new(".adaptive_terrain_probe")
    try:
        mesh.vertices.add(4)
        mesh.loops.add(6)
        mesh.polygons.add(2)
        mesh.vertices.foreach_set("co", np.array([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0], np.float32))
        mesh.loops.foreach_set("vertex_index", np.array(TRIANGLES, np.int32).ravel())
        data = mesh.uv_layers.new(name="UVMap", do_init=False).uv
        for items, name, dtype, values in (
            (mesh.polygons, "loop_start", wp.int32, OFFSETS),
            (data, "vector", wp.vec2f, CORNERS),
        ):
            items.foreach_set(name, values.ravel())
            array = _array_over(items, dtype)
            if array is None or not (array.numpy() == values).all():
                return False
            for written in (values[::-1], values):
                array.numpy()[:] = written
                read = np.empty(values.size, values.dtype)
                items.foreach_get(name, read)
                if not (read == written.ravel()).all():
                    return False
        mesh.update(calc_edges=True)
        return mesh.validate() is False  # nothing had to be repaired
    finally:
        bpy.data.meshes.remove(mesh)


def _array_over(items, dtype) -> wp.array | None:
    """Return a Warp array over the memory of a Blender collection; None if it is empty or its items are not contiguous.

    Blender owns the memory, and moves it when the mesh gets other items or attributes.
    """
    count = len(items)
    if not count:
        return None
    first, last = items[0].as_pointer(), items[count - 1].as_pointer()
    if last - first != (count - 1) * wp.types.type_size_in_bytes(dtype):
        return None
    return wp.array(ptr=first, shape=(count,), dtype=dtype, device="cpu")
