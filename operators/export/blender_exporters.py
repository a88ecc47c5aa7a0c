# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own exporters, each called so that it writes one object's mesh of the current frame and nothing else."""

import os
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import TerrainError

# Types of attributes that Blender's glTF exporter writes, and names of these types that it writes in another way.
GLTF_TYPES = ("FLOAT", "FLOAT2", "FLOAT_VECTOR", "FLOAT_COLOR")
RESERVED_NAMES = ("position", "custom_normal")
# An object is sheared if the cosine between two of its axes is larger: float32 rounds right angles to less.
SHEARED = 1e-5
# Options of Blender's exporters.
ONLY = {"export_selected_objects": True, "apply_modifiers": False}


@contextmanager
def only_selected(obj):
    """Select the object alone in the `with` block, for Blender's exporters; restore the user's selection afterwards.

    Raises TerrainError if it is hidden or cannot be selected.
    """
    import bpy

    if not obj.visible_get():
        raise TerrainError(f"The terrain {obj.name!r} is hidden, so Blender cannot export it", fix="show it")
    objects = list(bpy.context.view_layer.objects)
    selected = [other.select_get() for other in objects]
    try:
        for other in objects:
            other.select_set(other == obj)
        if not obj.select_get():
            raise TerrainError(
                f"The terrain {obj.name!r} cannot be selected, so Blender cannot export it", fix="make it selectable"
            )
        yield
    finally:
        for other, was in zip(objects, selected, strict=True):
            other.select_set(was)


def _enable_gltf() -> None:
    """Enable Blender's glTF add-on, which may be off."""
    import addon_utils

    if not addon_utils.check("io_scene_gltf2")[1]:  # [1]: whether it is enabled now
        addon_utils.enable("io_scene_gltf2")


def check_not_sheared(obj) -> None:
    """Raise TerrainError for a sheared object: a glTF node has a rotation and a scale only."""
    axes = [axis.normalized() for axis in obj.matrix_world.to_3x3().col]
    if max(abs(axes[k].dot(axes[k - 1])) for k in range(3)) > SHEARED:
        raise TerrainError(
            f"The terrain {obj.name!r} is sheared by its parent's scale, which a glb cannot hold",
            fix="apply that scale, or choose another format",
        )


def turn_faces_over(path: Path, faces: int) -> None:
    """Reverse the order of the corners of all faces in a binary .ply file.

    `faces`: their number; they are triangles and come last in the file, whose numbers are little endian.
    """
    face = np.dtype([("count", np.uint8), ("corners", "<u4", 3)])
    with path.open("r+b") as file:
        file.seek(-faces * face.itemsize, os.SEEK_END)
        records = np.fromfile(file, face, faces)
        records["corners"] = records["corners"][:, ::-1].copy()
        file.seek(-faces * face.itemsize, os.SEEK_END)
        file.write(records.tobytes())


def export_ply(_obj, name: str) -> None:
    """Write the selected object to a .ply."""
    import bpy

    bpy.ops.wm.ply_export(filepath=name, **ONLY, export_normals=True, export_uv=True)


def face_outwards(piece, path: Path) -> None:
    """Turn the faces of a mirrored object's .ply over, which Blender's exporter leaves facing inwards."""
    if piece.obj.matrix_world.determinant() < 0:
        turn_faces_over(path, len(piece.surface.triangles))


def export_obj(_obj, name: str) -> None:
    """Write the selected object to an .obj."""
    import bpy

    bpy.ops.wm.obj_export(filepath=name, **ONLY, export_materials=False)


def export_stl(_obj, name: str) -> None:
    """Write the selected object to an .stl."""
    import bpy

    bpy.ops.wm.stl_export(filepath=name, **ONLY)


def export_usda(obj, name: str) -> None:
    """Write the selected object to a .usda, without its modifiers. Raises TerrainError where Blender has no USD."""
    import bpy

    if not bpy.app.build_options.usd:
        raise TerrainError(
            "This Blender was built without USD", fix="choose another format, or Blender from blender.org"
        )
    shown = [modifier for modifier in obj.modifiers if modifier.show_viewport]
    try:
        for modifier in shown:
            modifier.show_viewport = False
        bpy.ops.wm.usd_export(
            filepath=name,
            selected_objects_only=True,
            export_animation=False,
            export_materials=False,
            xform_op_mode="MAT",  # others lose shear
            evaluation_mode="VIEWPORT",  # only the viewport's modifiers are off
        )
    finally:
        for modifier in shown:
            modifier.show_viewport = True


def export_glb(obj, name: str) -> None:
    """Write the selected object to a .glb. Raises TerrainError for a sheared object."""
    import bpy

    check_not_sheared(obj)
    _enable_gltf()
    with _underscored_names([obj.data]):  # glTF exports only attributes that begin with an underscore
        bpy.ops.export_scene.gltf(
            filepath=name,
            export_format="GLB",
            use_selection=True,
            export_current_frame=True,  # else it goes to frame 0
            export_animations=False,
            export_materials="NONE",
            export_attributes=True,
        )


@contextmanager
def _underscored_names(meshes):
    """Prefix the names of point attributes with an underscore in the `with` block: Blender's glTF exports no others."""
    renamed = []
    try:
        for mesh in meshes:
            names = [item.name for item in mesh.attributes if item.domain == "POINT" and item.data_type in GLTF_TYPES]
            for name in names:
                if name not in RESERVED_NAMES and not name.startswith(("_", ".")):
                    mesh.attributes[name].name = "_" + name
                    renamed.append((mesh, name))
        yield
    finally:
        for mesh, name in renamed:
            mesh.attributes["_" + name].name = name
