# SPDX-License-Identifier: GPL-3.0-or-later
"""The modifier of a scatter: a node group that puts a collection's objects on its points, in metres of the world."""

import bpy

from ..bridge.nodes import Nodes

MODIFIER = "Adaptive Scatter"
GROUP = "Adaptive Scatter in Metres"
OLD_GROUP = "Adaptive Scatter"  # of files of older versions: its instances follow the terrain's scale
COLLECTION, SCALE, CONE = "Collection", "Scale", "Cone Height"


def add_modifier(obj, cone_height: float) -> None:
    """Add the modifier to a scatter; cones of `cone_height` metres stand for a collection that is not chosen yet."""
    modifier = obj.modifiers.new(MODIFIER, "NODES")
    modifier.node_group = bpy.data.node_groups.get(GROUP) or new_scatter_group()
    _set_input(modifier, CONE, cone_height)


def set_collection(obj, collection) -> None:
    """Give a collection, or None, to the modifier of a scatter, if it still has one."""
    modifier = obj.modifiers.get(MODIFIER)
    if modifier is not None and _identifier(modifier, COLLECTION) is not None:
        _set_input(modifier, COLLECTION, collection)
        obj.update_tag()


def collection_of(obj):
    """Return the collection of a scatter's modifier, or None."""
    modifier = obj.modifiers.get(MODIFIER)
    name = None if modifier is None else _identifier(modifier, COLLECTION)
    if name is None:
        return None
    if hasattr(modifier, "properties"):  # Blender 5.2
        return getattr(modifier.properties.inputs, name).value
    return modifier.get(name)


def follows_scale(obj) -> bool:
    """Return whether the terrain's scale stretches the instances of a scatter, as in files of older versions."""
    modifier = obj.modifiers.get(MODIFIER)
    return modifier is not None and modifier.node_group is not None and modifier.node_group.name == OLD_GROUP


def _identifier(modifier, name: str) -> str | None:
    """Return the identifier of a modifier's input by its name; None without such an input."""
    items = modifier.node_group.interface.items_tree if modifier.node_group is not None else ()
    inputs = (item for item in items if item.item_type == "SOCKET" and item.in_out == "INPUT")
    return next((item.identifier for item in inputs if item.name == name), None)


def _set_input(modifier, name: str, value) -> None:
    """Set an input of a geometry-nodes modifier by its name."""
    identifier = _identifier(modifier, name)
    if hasattr(modifier, "properties"):  # Blender 5.2
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value


def new_scatter_group() -> bpy.types.NodeTree:
    """Create the node group that turns points into instances of a collection's objects.

    The attribute `variant` chooses the object, `rotation` turns it and `size` scales it. Objects keep their own
    rotation and scale. The terrain's scale moves the points and leaves the instances as they are: a size of 1 is the
    object's size in the world. Without a collection the instances are cones.
    """
    tree = bpy.data.node_groups.new(GROUP, "GeometryNodeTree")
    tree.is_modifier = True
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket(COLLECTION, in_out="INPUT", socket_type="NodeSocketCollection")
    for name in (SCALE, CONE):
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.default_value, socket.min_value = 1.0, 0.0
    nodes = Nodes(tree)
    group_inputs = nodes.add("NodeGroupInput").outputs

    def named(name: str, kind: str):
        """Add a node that reads the attribute `name`; return its output. kind: Blender's data type."""
        return nodes.add("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs["Attribute"]

    info = {"Separate Children": True, "Reset Children": False, "Collection": group_inputs[COLLECTION]}
    objects = nodes.add("GeometryNodeCollectionInfo", info).outputs[0]
    origin = nodes.add("FunctionNodeInputVector").outputs[0]  # (0, 0, 0): an object's location does not count
    objects = nodes.add("GeometryNodeSetPosition", {"Geometry": objects, "Position": origin}).outputs[0]
    count = nodes.add("GeometryNodeAttributeDomainSize", {"Geometry": objects}, component="INSTANCES")
    height = group_inputs[CONE]
    radius = nodes.math("MULTIPLY", height, 0.3)
    cone = nodes.add("GeometryNodeMeshCone", {"Vertices": 8, "Radius Bottom": radius, "Depth": height})
    has_objects = nodes.math("GREATER_THAN", count.outputs["Instance Count"], 0.5)
    cones = nodes.add("GeometryNodeGeometryToInstance", {0: cone.outputs["Mesh"]}).outputs[0]
    sides = {"Switch": has_objects, "False": cones, "True": objects}
    switch = nodes.add("GeometryNodeSwitch", sides, input_type="GEOMETRY")
    size = nodes.math("MULTIPLY", named("size", "FLOAT"), group_inputs[SCALE])
    inputs = {
        "Points": group_inputs["Geometry"],
        "Instance": switch.outputs["Output"],
        "Pick Instance": True,
        "Instance Index": named("variant", "INT"),
        "Rotation": named("rotation", "QUATERNION"),
        "Scale": size,
    }
    placed = nodes.add("GeometryNodeInstanceOnPoints", inputs).outputs["Instances"]
    this = nodes.add("GeometryNodeSelfObject").outputs[0]
    scale = nodes.add("GeometryNodeObjectInfo", {"Object": this}, transform_space="ORIGINAL").outputs["Scale"]
    # Each instance is scaled about its point by the inverse of the object's scale, which comes from the terrain.
    inputs = {
        "Instances": placed,
        "Scale": nodes.vector("DIVIDE", (1.0, 1.0, 1.0), nodes.vector("ABSOLUTE", scale)),
        "Center": nodes.add("GeometryNodeInputPosition").outputs[0],
        "Local Space": False,
    }
    nodes.add("NodeGroupOutput", {"Geometry": nodes.add("GeometryNodeScaleInstances", inputs).outputs[0]})
    nodes.arrange()
    return tree
