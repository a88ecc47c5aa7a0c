# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own exporters, each called so that it writes one object's mesh of the current frame and nothing else."""

import os
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import TerrainError

# Blender's types of attributes that glTF knows, and those of such a type that are no attributes of ours.
GLTF_TYPES = ("FLOAT", "FLOAT2", "FLOAT_VECTOR", "FLOAT_COLOR")
OWN_NAMES = ("position", "custom_normal")
# Cosine between axes of an object; float32 rounds those of one that is not sheared to less.
SHEARED = 1e-5


@contextmanager
def only_selected(obj):
    """Blender's exporters write what is selected; the user's selection comes back afterwards."""
    import bpy

    if not obj.visible_get():
        raise TerrainError(f"The terrain {obj.name!r} is hidden, so Blender cannot export it; show it.")
    objects = list(bpy.context.view_layer.objects)
    selected = [other.select_get() for other in objects]
    try:
        for other in objects:
            other.select_set(other == obj)
        if not obj.select_get():
            raise TerrainError(
                f"The terrain {obj.name!r} is barred from selection, so Blender cannot export it; free it."
            )
        yield
    finally:
        for other, was in zip(objects, selected, strict=True):
            other.select_set(was)


def _enable_gltf() -> None:
    """The glTF exporter is an add-on of Blender's own; it may be off."""
    import addon_utils

    if not addon_utils.check("io_scene_gltf2")[1]:
        addon_utils.enable("io_scene_gltf2")


def need_no_shear(obj) -> None:
    """Raise TerrainError where an object has no place in glTF: a node there has a rotation and a scale, no shear."""
    axes = [axis.normalized() for axis in obj.matrix_world.to_3x3().col]
    if max(abs(axes[k].dot(axes[k - 1])) for k in range(3)) > SHEARED:
        raise TerrainError(
            f"The terrain {obj.name!r} is sheared by its parent's scale, which a glb cannot hold; apply that scale, or "
            "choose another format."
        )


def turn_faces_over(path: Path, faces: int) -> None:
    """Turn the winding of all `faces` of a .ply over, which are last in the file. Of a mirrored object Blender's other
    exporters do so themselves."""
    face = np.dtype([("count", np.uint8), ("corners", "<u4", 3)])
    with path.open("r+b") as file:
        file.seek(-faces * face.itemsize, os.SEEK_END)
        turned = np.fromfile(file, face, faces)
        turned["corners"] = turned["corners"][:, ::-1].copy()
        file.seek(-faces * face.itemsize, os.SEEK_END)
        file.write(turned.tobytes())


def export_selected(name: str, form: str) -> None:
    """Have Blender's exporter of this format write what is selected to the file `name`."""
    import bpy

    only = {"filepath": name, "export_selected_objects": True, "apply_modifiers": False}
    if form == "ply":
        bpy.ops.wm.ply_export(**only, export_normals=True, export_uv=True)
    elif form == "obj":
        bpy.ops.wm.obj_export(**only, export_materials=False)
    elif form == "stl":
        bpy.ops.wm.stl_export(**only)
    else:
        _enable_gltf()
        with _gltf_names(obj.data for obj in bpy.context.selected_objects if obj.type == "MESH"):
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
def _gltf_names(meshes):
    """glTF takes attributes of vertices whose names begin with an underscore: while it is written ours do."""
    renamed = []
    try:
        for mesh in meshes:
            names = [item.name for item in mesh.attributes if item.domain == "POINT" and item.data_type in GLTF_TYPES]
            for name in names:
                if name not in OWN_NAMES and not name.startswith(("_", ".")):
                    mesh.attributes[name].name = "_" + name
                    renamed.append((mesh, name))
        yield
    finally:
        for mesh, name in renamed:
            mesh.attributes["_" + name].name = name
