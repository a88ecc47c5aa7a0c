# SPDX-License-Identifier: GPL-3.0-or-later
"""Viewshed: the part of a terrain visible from an object or the camera, as an image and an attribute."""

import bpy
import numpy as np

from ..bridge import camera as cameras
from ..bridge.nodes import Nodes
from ..bridge.writer import UV_LAYER
from ..session.polls import cancelled_by_errors
from .chosen import GroundOperator, selected_objects, terrain_at

NAME = "viewshed"
MARK = "adaptive_terrain_viewshed"  # custom property of the image and the node group: the name of their terrain
MAX_PIXELS = 4096  # along a side; Blender needs 16 bytes per pixel for writing


class Viewshed(GroundOperator, bpy.types.Operator):
    """Find the ground that the active object sees, or the scene's camera if a terrain is active: makes an image of the
    whole terrain, white where it is seen"""

    bl_idname = "adaptive_terrain.viewshed"
    bl_label = "Viewshed"
    bl_options = {"REGISTER", "UNDO"}

    modules = (*GroundOperator.modules, "query.viewshed")

    target_height: bpy.props.FloatProperty(
        name="Target Height",
        description="Height above the ground of the things to be seen, in metres; 0 is the ground itself",
        min=0.0,
        unit="LENGTH",
    )
    radius: bpy.props.FloatProperty(
        name="Radius", description="How far to look, in metres; 0: over the whole terrain", min=0.0, unit="LENGTH"
    )
    attribute: bpy.props.BoolProperty(
        name="Attribute",
        description="Add a modifier to the terrain that gives its materials the result as the attribute viewshed",
        default=True,
    )

    @classmethod
    def poll(cls, context):
        """Return whether there is ground and an eye that looks at it; otherwise set the reason that Blender shows."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Make the object that looks active, or a terrain to be seen from the scene's camera")
        return _eye(context) is not None

    @cancelled_by_errors
    def execute(self, context):
        """Compute the ground that the active object or the camera sees, as an image and an attribute."""
        from ...cbt_terrain.query.viewshed import viewshed

        depsgraph, eye = context.evaluated_depsgraph_get(), _eye(context)
        point = np.array([eye.evaluated_get(depsgraph).matrix_world.translation], np.float64)
        terrain, ground = terrain_at(context, point, repr(eye.name), depsgraph)
        seen = viewshed(
            ground.field, ground.to_local(point)[0], self.target_height, self.radius or None, **ground.scale_and_offset
        )
        image = _make_image(terrain, seen)
        if self.attribute:
            _add_modifier(terrain, image)
        self.report({"INFO"}, f"{eye.name} sees {seen.mean():.1%} of {terrain.name}: image {image.name!r}")
        return {"FINISHED"}


def _eye(context):
    """Return the object that looks, None without one.

    It is the active object if that is no terrain, else a selected object, else the camera.
    """
    obj = context.object
    if obj is not None and not obj.adaptive_terrain.enabled:
        return obj
    return next(iter(selected_objects(context)), None) or cameras.active_camera(context.scene)


def _find_marked(items, terrain):
    """Return the image or node group of a terrain, by its mark, since Blender cuts long names."""
    return next((item for item in items if item.get(MARK) == terrain.name and not item.library), None)


def _make_image(terrain, seen: np.ndarray):
    """Return a packed image that is white where `seen` is True, bool [rows, columns], row 0 in the south.

    Large rasters get a pixel per n-th sample. The terrain's old image is reused if its size fits.
    """
    step = -(-max(seen.shape) // MAX_PIXELS)  # rounded up
    seen = seen[::step, ::step]
    rows, columns = seen.shape
    image = _find_marked(bpy.data.images, terrain)
    if image is None or tuple(image.size) != (columns, rows):
        if image is not None:
            bpy.data.images.remove(image)
        image = bpy.data.images.new(f"{terrain.name} {NAME}", columns, rows, is_data=True)
        image[MARK] = terrain.name
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = seen[..., None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()  # keeps it in the .blend file
    image.update_tag()
    return image


def _add_modifier(terrain, image) -> None:
    """Have geometry nodes store the image's value at each vertex of every new mesh; reuse those of an earlier run."""
    modifier = terrain.modifiers.get(NAME) or terrain.modifiers.new(NAME, "NODES")
    group = _find_marked(bpy.data.node_groups, terrain) or _create_group(f"{terrain.name} {NAME}")
    group[MARK] = terrain.name
    modifier.node_group = group
    node = next(node for node in group.nodes if node.bl_idname == "GeometryNodeImageTexture")
    node.inputs["Image"].default_value = image
    # UV is 0 and 1 at the first and the last sample, but pixels have their centres half a pixel inside.
    size = np.array([*image.size, 1.0])
    to_image = next(node for node in group.nodes if node.bl_idname == "ShaderNodeVectorMath")  # a factor and a sum
    to_image.inputs[1].default_value = (size - [1.0, 1.0, 0.0]) / size
    to_image.inputs[2].default_value = [*(0.5 / size[:2]), 0.0]


def _create_group(name: str):
    """Create the geometry nodes that store the value of an image at each vertex as the attribute NAME.

    `_add_modifier` sets the image, and the factor and the sum that turn UV into a position in it.
    """
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket(name="Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    nodes = Nodes(group)
    mesh = nodes.add("NodeGroupInput").outputs[0]
    uv = nodes.add("GeometryNodeInputNamedAttribute", {"Name": UV_LAYER}, data_type="FLOAT_VECTOR").outputs["Attribute"]
    to_image = nodes.vector("MULTIPLY_ADD", uv)
    value = nodes.add("GeometryNodeImageTexture", {"Vector": to_image}, extension="EXTEND").outputs["Color"]
    stored = nodes.add("GeometryNodeStoreNamedAttribute", {"Geometry": mesh, "Value": value, "Name": NAME})
    nodes.add("NodeGroupOutput", {0: stored.outputs["Geometry"]})
    for number, node in enumerate(group.nodes):
        node.location = (200 * number, 0)
    return group
