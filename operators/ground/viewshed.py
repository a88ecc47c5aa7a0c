# SPDX-License-Identifier: GPL-3.0-or-later
"""Viewshed: what of a terrain an object or the camera sees, as an image over it and as an attribute of its mesh."""

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.query.viewshed import viewshed
from ..mesh.writer import UV_LAYER
from ..request import camera as cameras
from ..scene import session
from . import world_ground
from .chosen import active_terrain, has_ground, selected

NAME = "viewshed"
MARK = "adaptive_terrain_viewshed"  # a property of the image and of the node group: the name of their terrain
MOST_PIXELS = 4096  # along a side; Blender keeps 16 bytes a pixel while it is written


class Viewshed(bpy.types.Operator):
    """Find what of the terrain is in sight of the active object, or of the scene's camera where a terrain is active:
    an image over the whole terrain, white where it is seen, and by it the attribute "viewshed" of the mesh"""

    bl_idname = "adaptive_terrain.viewshed"
    bl_label = "Viewshed"
    bl_options = {"REGISTER", "UNDO"}

    target_height: bpy.props.FloatProperty(
        name="Target Height", description="Metres above the ground of what is to be seen", min=0.0, unit="LENGTH"
    )
    radius: bpy.props.FloatProperty(
        name="Radius", description="Look only so far, in metres of the terrain; 0: everywhere", min=0.0, unit="LENGTH"
    )
    attribute: bpy.props.BoolProperty(
        name="Attribute",
        description='Give the terrain a modifier that makes the attribute "viewshed" of the image',
        default=True,
    )

    @classmethod
    def poll(cls, context):
        if not has_ground(cls, context):
            return False
        cls.poll_message_set("Make the object that looks active, or a terrain to be seen from the scene's camera")
        return _eye(context) is not None

    def execute(self, context):
        depsgraph, eye = context.evaluated_depsgraph_get(), _eye(context)
        try:
            point = np.array([eye.evaluated_get(depsgraph).matrix_world.translation], np.float64)
            terrain, ground = _seen_terrain(context, eye, point, depsgraph)
            seen = viewshed(
                ground.field, ground.to_own(point)[0], self.target_height, self.radius or None, **ground.heights
            )
            image = _image(terrain, seen)
            if self.attribute:
                _add_modifier(terrain, image)
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{eye.name} sees {seen.mean():.1%} of {terrain.name}: image {image.name!r}")
        return {"FINISHED"}


def _eye(context):
    """The active object, or the camera; None where neither can look."""
    obj = context.object
    if obj is not None and not obj.adaptive_terrain.enabled:
        return obj
    return next(iter(selected(context)), None) or cameras.active_camera(context.scene)


def _seen_terrain(context, eye, point: np.ndarray, depsgraph):
    """The active terrain if it is selected, else the one below the eye. Raises TerrainError."""
    terrain = active_terrain(context)
    if terrain is not None:
        return terrain, world_ground.ground_of(terrain, depsgraph)
    found = world_ground.grounds_of(context.scene, depsgraph)
    [which] = world_ground.below(found, point).which
    if which < 0:
        raise TerrainError(f"There is no terrain below {eye.name!r}: select the terrain that is to be looked at.")
    terrains = {obj.session_uid: obj for obj in session.terrains_of(context.scene)}
    return terrains[found[which].uid], found[which]


def _own(items, terrain):
    """Of images or node groups the one that was made for a terrain. Its name does not tell: Blender cuts long ones."""
    return next((item for item in items if item.get(MARK) == terrain.name and not item.library), None)


def _image(terrain, seen: np.ndarray):
    """White where `seen`, bool [rows, columns], row 0 south: a pixel a sample, or every so manieth."""
    step = -(-max(seen.shape) // MOST_PIXELS)
    seen = seen[::step, ::step]
    rows, columns = seen.shape
    image = _own(bpy.data.images, terrain)
    if image is None or tuple(image.size) != (columns, rows):
        if image is not None:
            bpy.data.images.remove(image)
        image = bpy.data.images.new(f"{terrain.name} {NAME}", columns, rows, is_data=True)
        image[MARK] = terrain.name
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = seen[..., None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()  # or it would be gone with the session
    image.update_tag()
    return image


def _add_modifier(terrain, image) -> None:
    """Geometry nodes that store the image's value at each vertex. A mesh that is made anew runs through them again."""
    modifier = terrain.modifiers.get(NAME) or terrain.modifiers.new(NAME, "NODES")
    group = _own(bpy.data.node_groups, terrain) or _group(f"{terrain.name} {NAME}")
    group[MARK] = terrain.name
    modifier.node_group = group
    node = next(node for node in group.nodes if node.bl_idname == "GeometryNodeImageTexture")
    node.inputs["Image"].default_value = image
    # The first and the last sample lie on the rim, where UV is 0 and 1; pixels lie half a pixel inside.
    size = np.array([*image.size, 1.0])
    scale = next(node for node in group.nodes if node.bl_idname == "ShaderNodeVectorMath")
    scale.inputs[1].default_value = (size - [1.0, 1.0, 0.0]) / size
    scale.inputs[2].default_value = [*(0.5 / size[:2]), 0.0]


def _group(name: str):
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket(name="Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeInputNamedAttribute", "ShaderNodeVectorMath", "GeometryNodeImageTexture",
             "GeometryNodeStoreNamedAttribute", "NodeGroupOutput")  # fmt: skip
    begin, uv, place, texture, store, end = (group.nodes.new(kind) for kind in kinds)
    for number, node in enumerate((begin, uv, place, texture, store, end)):
        node.location = (200 * number, 0)
    uv.data_type, place.operation, texture.extension = "FLOAT_VECTOR", "MULTIPLY_ADD", "EXTEND"
    uv.inputs["Name"].default_value, store.inputs["Name"].default_value = UV_LAYER, NAME
    links = (
        (begin.outputs[0], store.inputs["Geometry"]), (uv.outputs["Attribute"], place.inputs[0]),
        (place.outputs["Vector"], texture.inputs["Vector"]), (texture.outputs["Color"], store.inputs["Value"]),
        (store.outputs["Geometry"], end.inputs[0]),
    )  # fmt: skip
    for source, goal in links:
        group.links.new(source, goal)
    return group


register, unregister = bpy.utils.register_classes_factory((Viewshed,))
