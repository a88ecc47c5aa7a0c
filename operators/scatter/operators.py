# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Scatter: points on a terrain, and the node group that puts a collection's objects on them."""

import math

import bpy

from ...cbt_terrain.errors import TerrainError
from ..bridge.nodes import Nodes
from ..bridge.scene_paths import absolute_path
from ..session import session
from ..session.polls import on_terrain_object
from .request import scatters_of

GROUP = "Adaptive Scatter"
COLLECTION, SCALE = "Collection", "Scale"
# Spacings in a terrain's longer side: 40,000 points on a square one, twice as many at most, as spacings have one digit.
PER_SIDE = 200
# Of a spacing: density is full over a whole terrain that one looks at from its side; what stands there is a spacing
# high, and throws a shadow.
FULL_SPACINGS, REACH_SPACINGS = 200, 2


class AddScatter(bpy.types.Operator):
    """Add points that keep their places on the terrain, as dense as the camera can see; choose a collection in their
    modifier"""

    bl_idname = "adaptive_terrain.scatter_add"
    bl_label = "Add Scatter"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return on_terrain_object(cls, context)

    def invoke(self, context, _event):
        """Add the scatter without waiting for kernels; the live update makes the points."""
        return self._add(context.object, waits=not context.object.adaptive_terrain.live)

    def execute(self, context):
        return self._add(context.object, waits=True)

    def _add(self, terrain, waits: bool):
        settings = terrain.adaptive_terrain
        try:
            if not settings.store:
                raise TerrainError(f"The terrain {terrain.name!r} has no height field", fix="import one from its panel")
            west, south, east, north = session.open_field(absolute_path(settings.store)).lattice.rectangle()
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        spacing = rounded(max(east - west, north - south) / PER_SIDE)
        obj = new_scatter(terrain, spacing)
        if waits:
            try:
                session.update_object(terrain)
            except TerrainError as error:
                self.report({"WARNING"}, str(error))
            self.report({"INFO"}, f"{len(obj.data.vertices):,} points")
        return {"FINISHED"}


def new_scatter(terrain, spacing: float):
    """Create an object with a scatter of a terrain, one point on `spacing` x `spacing` metres, and the node group."""
    obj = bpy.data.objects.new(f"{terrain.name} Scatter", bpy.data.meshes.new(f"{terrain.name} Scatter"))
    settings = obj.adaptive_scatter
    settings.enabled, settings.spacing = True, spacing
    settings.size, settings.seed = spacing, len(scatters_of(terrain))
    in_world = spacing * max(terrain.matrix_world.to_scale()[:2])
    settings.full_until, settings.margin_m = FULL_SPACINGS * in_world, REACH_SPACINGS * in_world
    obj.parent = terrain
    for collection in terrain.users_collection:
        collection.objects.link(obj)
    modifier = obj.modifiers.new(GROUP, "NODES")
    modifier.node_group = bpy.data.node_groups.get(GROUP) or _group()
    return obj


def rounded(value: float) -> float:
    """Round to one digit."""
    ten = 10.0 ** math.floor(math.log10(value))
    return round(value / ten) * ten


def _group() -> bpy.types.NodeTree:
    """Create the node group that turns points into instances of a collection's objects.

    The attribute `variant` chooses the object, `rotation` turns it and `size` scales it. Without a collection the
    instances are cones.
    """
    tree = bpy.data.node_groups.new(GROUP, "GeometryNodeTree")
    tree.is_modifier = True
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket(COLLECTION, in_out="INPUT", socket_type="NodeSocketCollection")
    scale = tree.interface.new_socket(SCALE, in_out="INPUT", socket_type="NodeSocketFloat")
    scale.default_value, scale.min_value = 1.0, 0.0
    nodes = Nodes(tree)
    given = nodes.add("NodeGroupInput").outputs

    def named(name: str, kind: str):
        return nodes.add("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs["Attribute"]

    whole = {"Separate Children": True, "Reset Children": True, "Collection": given[COLLECTION]}
    objects = nodes.add("GeometryNodeCollectionInfo", whole).outputs[0]
    count = nodes.add("GeometryNodeAttributeDomainSize", {"Geometry": objects}, component="INSTANCES")
    cone = nodes.add("GeometryNodeMeshCone", {"Vertices": 8, "Radius Bottom": 0.3, "Depth": 1.0})
    any_there = nodes.math("GREATER_THAN", count.outputs["Instance Count"], 0.5)
    cones = nodes.add("GeometryNodeGeometryToInstance", {0: cone.outputs["Mesh"]}).outputs[0]
    either = {"Switch": any_there, "False": cones, "True": objects}
    switch = nodes.add("GeometryNodeSwitch", either, input_type="GEOMETRY")
    size = nodes.math("MULTIPLY", named("size", "FLOAT"), given[SCALE])
    inputs = {
        "Points": given["Geometry"],
        "Instance": switch.outputs["Output"],
        "Pick Instance": True,
        "Instance Index": named("variant", "INT"),
        "Rotation": named("rotation", "QUATERNION"),
        "Scale": size,
    }
    placed = nodes.add("GeometryNodeInstanceOnPoints", inputs)
    nodes.add("NodeGroupOutput", {"Geometry": placed.outputs["Instances"]})
    nodes.arrange()
    return tree


CLASSES = (AddScatter,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
