# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of demand: each builds scenes and yields the attributes that are read of the mesh, and the expected ones.

`demand(obj, mode="RENDER")` is handed in: the bpy modules and the real program have it by other names.
"""

import bpy
from demand_trees import (
    EEVEE,
    Moved,
    attribute,
    colour,
    emit,
    enabled,
    group,
    mix,
    new_material,
    new_object,
    shows,
    worn,
)

ALL, ACTIVE_COLOR, ACTIVE_UV = "*", "<active color>", "<active uv>"


def links_that_count(demand):
    obj, tree, output = worn()
    node = attribute(tree, "a")
    attribute(tree, "loose")
    emit(tree, node.outputs["Color"], output)
    yield "what is not linked", demand(obj), {"a"}
    node.mute = True
    yield "a muted node", demand(obj), set()
    node.mute = False
    tree.links[-1].is_muted = True
    yield "a muted link", demand(obj), set()
    obj, tree, output = worn()
    emit(tree, attribute(tree, "a", "OBJECT").outputs["Color"], output)
    yield "a property of the object", demand(obj), set()


def mixed_colours(demand):
    for factor, wanted in ((0.0, {"a"}), (1.0, {"b"}), (0.5, {"a", "b"})):
        obj, tree, output = worn()
        node = mix(tree, factor, colour(tree, "a"), colour(tree, "b"))
        tree.links.new(attribute(tree, "of another data type").outputs["Fac"], node.inputs[2])
        emit(tree, node.outputs[2], output)
        yield f"a factor of {factor}", demand(obj), wanted
        node.blend_type = "ADD"
        yield f"added by {factor}", demand(obj), {"a"} if factor == 0 else {"a", "b"}
        node.blend_type = "MIX"
        node.inputs[0].keyframe_insert("default_value", frame=1)
        yield f"a factor of {factor}, animated", demand(obj), {"a", "b"}


def mixed_shaders(demand):
    for factor, wanted in ((0.0, {"a"}), (1.0, {"b"}), (0.5, {"a", "b"})):
        obj, tree, output = worn()
        node = tree.nodes.new("ShaderNodeMixShader")
        node.inputs[0].default_value = factor
        for number, name in ((1, "a"), (2, "b")):
            shader = tree.nodes.new("ShaderNodeEmission")
            tree.links.new(colour(tree, name), shader.inputs[0])
            tree.links.new(shader.outputs[0], node.inputs[number])
        tree.links.new(node.outputs[0], output.inputs[0])
        yield f"shaders by {factor}", demand(obj), wanted
        node.inputs[0].driver_add("default_value")
        yield f"shaders by {factor}, driven", demand(obj), {"a", "b"}


def animated_nodes(demand):
    obj, tree, output = worn()
    node = mix(tree, 1.0, colour(tree, "a"), colour(tree, "b"))
    emit(tree, node.outputs[2], output)
    yield "a mix", demand(obj), {"b"}
    node.name = 'a "quoted" name'
    node.keyframe_insert("blend_type", frame=1)
    yield "a mix whose kind is animated", demand(obj), {"a", "b"}


def groups_used_twice(demand):
    obj, tree, output = worn()
    sockets = ("A", "Color"), ("B", "Color"), ("F", "Float")
    inner, given, end = group("G", "ShaderNodeTree", sockets, [("Mixed", "Color"), ("Other", "Color")])
    node = mix(inner, 0.5, given.outputs[0], given.outputs[1])
    inner.links.new(given.outputs[2], node.inputs[0])
    inner.links.new(node.outputs[2], end.inputs[0])
    inner.links.new(colour(inner, "inner"), end.inputs[1])
    first, second = (tree.nodes.new("ShaderNodeGroup") for _ in range(2))
    for used, names, factor in ((first, ("a", "b"), 0.0), (second, ("c", "d"), 1.0)):
        used.node_tree = inner
        for number, name in enumerate(names):
            tree.links.new(colour(tree, name), used.inputs[number])
        used.inputs[2].default_value = factor
    shader = emit(tree, mix(tree, 0.5, first.outputs[0], second.outputs[0]).outputs[2], output)
    yield "a group twice, each with its factor", demand(obj), {"a", "d"}
    tree.links.new(first.outputs[1], shader.inputs[1])
    yield "the group's other output", demand(obj), {"a", "d", "inner"}
    first.mute = True
    yield "a muted group passes through", demand(obj), {"a", "d"}


def nested_groups(demand):
    obj, tree, output = worn()
    inner, _, end = group("I", "ShaderNodeTree", outputs=[("C", "Color")])
    inner.links.new(colour(inner, "deep"), end.inputs[0])
    outer, _, end = group("O", "ShaderNodeTree", outputs=[("C", "Color")])
    used, reroute = outer.nodes.new("ShaderNodeGroup"), outer.nodes.new("NodeReroute")
    used.node_tree = inner
    outer.links.new(used.outputs[0], reroute.inputs[0])
    outer.links.new(reroute.outputs[0], end.inputs[0])
    shown = tree.nodes.new("ShaderNodeGroup")
    shown.node_tree = outer
    emit(tree, shown.outputs[0], output)
    yield "nested groups and a reroute", demand(obj), {"deep"}


def outputs_of_engines(demand):
    obj, tree, output = worn()
    other = tree.nodes.new("ShaderNodeOutputMaterial")
    output.target, other.target = "CYCLES", "EEVEE"
    emit(tree, colour(tree, "c"), output)
    emit(tree, colour(tree, "e"), other)
    render, scene = bpy.context.scene.render, bpy.context.scene
    yield "the output of Cycles", demand(obj), {"c"}
    yield "a viewport, where EEVEE is a click away", demand(obj, "VIEWPORT"), {"c", "e"}
    render.engine = EEVEE
    yield "the output of EEVEE", demand(obj), {"e"}
    render.engine = "BLENDER_WORKBENCH"
    yield "Workbench reads no material", demand(obj), set()
    scene.display.shading.color_type = "VERTEX"
    yield "Workbench by attribute", demand(obj), {ACTIVE_COLOR}


def other_outputs(demand):
    obj, tree, output = worn()
    aov = tree.nodes.new("ShaderNodeOutputAOV")
    aov.aov_name = "wet"
    tree.links.new(colour(tree, "w"), aov.inputs[0])
    yield "an AOV that no view layer has", demand(obj), set()
    bpy.context.view_layer.aovs.add().name = "wet"
    yield "an AOV", demand(obj), {"w"}
    obj, tree, output = worn()
    displaced = tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(attribute(tree, "h").outputs["Fac"], displaced.inputs[0])
    tree.links.new(displaced.outputs[0], output.inputs["Displacement"])
    yield "displacement", demand(obj), {"h"}


def slots_and_overrides(demand):
    obj, tree, output = worn()
    emit(tree, colour(tree, "first"), output)
    second = obj.data.materials[0].copy()
    second.node_tree.nodes["Attribute"].attribute_name = "second"
    obj.data.materials.append(second)
    yield "a slot that no face uses", demand(obj), {"first"}
    obj.data.polygons[0].material_index = 1
    yield "the slot that faces use", demand(obj), {"second"}
    bpy.context.view_layer.material_override = obj.data.materials[0]
    yield "an override", demand(obj), {"first"}
    bpy.context.scene.view_layers.new("Without")
    yield "an override of one view layer", demand(obj), {"first", "second"}


def colours_and_uvs(demand):
    obj, tree, output = worn()
    node = tree.nodes.new("ShaderNodeVertexColor")
    emit(tree, node.outputs[0], output)
    yield "the active colour", demand(obj), {ACTIVE_COLOR}
    node.layer_name = "k"
    yield "a named colour", demand(obj), {"k"}
    obj, tree, output = worn()
    emit(tree, tree.nodes.new("ShaderNodeTexImage").outputs[0], output)
    yield "an image texture by itself", demand(obj), {ACTIVE_UV}
    obj, tree, output = worn()
    emit(tree, tree.nodes.new("ShaderNodeTexCoord").outputs["Object"], output)
    yield "coordinates of the object", demand(obj), set()


def weights_of_zero(demand):
    obj, tree, output = worn()
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    tree.links.new(colour(tree, "glow"), shader.inputs["Emission Color"])
    tree.links.new(colour(tree, "base"), shader.inputs["Base Color"])
    tree.links.new(shader.outputs[0], output.inputs[0])
    shader.inputs["Emission Strength"].default_value = 0
    yield "emission of strength 0", demand(obj), {"base"}


def scripts_in_shaders(demand):
    """Yield a script in a shader. Its sockets are added here: not every build of Cycles compiles scripts."""
    obj, tree, output = worn()
    bpy.context.scene.cycles.shading_system = True
    node = tree.nodes.new("ShaderNodeScript")
    node.outputs.new("NodeSocketColor", "C")
    emit(tree, node.outputs[0], output)
    yield "an OSL script", demand(obj), {ALL}
    bpy.context.scene.cycles.shading_system = False
    yield "a script without OSL", demand(obj), set()


def named_attributes(demand):
    obj, _, _ = worn()
    moved = Moved(obj)
    moved.reads("off")
    moved.named("loose")
    yield "a named attribute", demand(obj), {"off"}
    viewer, viewed = moved.tree.nodes.new("GeometryNodeViewer"), moved.named("viewed")
    socket = enabled(viewer.inputs)[-1]
    if socket.type == "CUSTOM":
        viewer.viewer_items.new("FLOAT", "v")
        socket = next(item for item in viewer.inputs if item.type == "VALUE")
    moved.tree.links.new(viewed.outputs[0], socket)
    yield "a viewer in a render", demand(obj), {"off"}
    yield "a viewer in the viewport", demand(obj, "VIEWPORT"), {"off", "viewed"}
    moved.tree.nodes.remove(viewer)
    moved.modifier.show_render = False
    yield "a modifier that renders leave out", demand(obj), set()
    yield "the same in the viewport", demand(obj, "VIEWPORT"), {"off"}
    obj.keyframe_insert(f'modifiers["{moved.modifier.name}"].show_render', frame=1)
    yield "a modifier that is on at times", demand(obj), {"off"}


def names_that_are_given(demand):
    obj, _, _ = worn()
    moved = Moved(obj)
    node = moved.named("")
    moved.tree.links.new(moved.given.outputs["Name"], node.inputs["Name"])
    moved.tree.links.new(node.outputs[0], moved.offset)
    moved.put("Name", "given")
    yield "a name from the modifier", demand(obj), {"given"}
    obj.driver_add(f'modifiers["{moved.modifier.name}"].show_viewport')
    moved.compute_name(node)
    yield "a name that is computed", demand(obj), {ALL}
    obj, _, _ = worn()
    moved = Moved(obj)
    moved.tree.links.new(moved.given.outputs["F"], moved.offset)
    moved.put_attribute("F", "field")
    yield "an attribute in place of a value", demand(obj), {"field"}


def switches(demand):
    obj, _, _ = worn()
    moved = Moved(obj)
    node = moved.tree.nodes.new("GeometryNodeSwitch")
    node.input_type = "VECTOR"
    off, on = moved.named("no"), moved.named("yes")
    sources = moved.given.outputs["S"], off.outputs[0], on.outputs[0]
    for source, socket in zip(sources, enabled(node.inputs), strict=True):
        moved.tree.links.new(source, socket)
    moved.tree.links.new(enabled(node.outputs)[0], moved.offset)
    moved.put("S", False)
    yield "a switch that is off", demand(obj), {"no"}
    moved.put("S", True)
    yield "a switch that is on", demand(obj), {"yes"}


def materials_by_nodes(demand):
    obj, _, _ = worn()
    moved = Moved(obj)
    node = moved.tree.nodes.new("GeometryNodeSetMaterial")
    node.inputs["Material"].default_value = shows(new_material("Set"), lambda tree: colour(tree, "set"))
    moved.tree.links.new(moved.mover.outputs[0], node.inputs[0])
    moved.tree.links.new(node.outputs[0], moved.end.inputs[0])
    yield "a material that nodes set", demand(obj), {"set"}
    value = moved.tree.nodes.new("GeometryNodeInputMaterial")
    value.material = shows(new_material("Value"), lambda tree: colour(tree, "value"))
    moved.tree.links.new(value.outputs[0], node.inputs["Material"])
    yield "a material as a node of its own", demand(obj), {"set", "value"}


def instances(demand):
    """Yield instances on the terrain's points, which may read its attributes."""
    obj, _, _ = worn()
    tree_object = new_object("Tree")
    material = shows(new_material(), lambda tree: attribute(tree, "tint", "INSTANCER").outputs["Color"])
    tree_object.data.materials.append(material)
    moved = Moved(obj)
    yield "an object that nothing instances", demand(obj), set()
    taken, spread = (moved.tree.nodes.new("GeometryNode" + kind) for kind in ("ObjectInfo", "InstanceOnPoints"))
    taken.inputs["Object"].default_value = tree_object
    moved.tree.links.new(taken.outputs["Geometry"], spread.inputs["Instance"])
    moved.tree.links.new(moved.mover.outputs[0], spread.inputs["Points"])
    moved.tree.links.new(spread.outputs[0], moved.end.inputs[0])
    yield "an instance on its points", demand(obj), {"tint"}


def other_objects(demand):
    obj, _, _ = worn()
    other = new_object("Other")
    moved = Moved(other)
    taken = moved.tree.nodes.new("GeometryNodeObjectInfo")
    moved.tree.links.new(taken.outputs["Geometry"], moved.mover.inputs[0])
    moved.reads("taken")
    yield "another object's nodes", demand(obj), set()
    taken.inputs["Object"].default_value = obj
    yield "another object's nodes that take it", demand(obj), {"taken"}
    if hasattr(bpy.types, "GeometryNodeInputObject"):
        value = moved.tree.nodes.new("GeometryNodeInputObject")
        value.object, taken.inputs["Object"].default_value = obj, None
        moved.tree.links.new(value.outputs[0], taken.inputs["Object"])
        yield "an object as a node of its own", demand(obj), {"taken"}
    other.modifiers.new("Transfer", "DATA_TRANSFER").object = obj
    yield "a data transfer", demand(obj), {"taken", ALL}


def objects_in_collections(demand):
    """Yield objects of a collection; an instance brings them into the scene."""
    obj, _, _ = worn()
    hidden, twin = bpy.data.collections.new("Kit"), bpy.data.objects.new("Twin", obj.data)
    hidden.objects.link(twin)
    twin.material_slots[0].link = "OBJECT"
    twin.material_slots[0].material = shows(new_material(), lambda tree: colour(tree, "twin"))
    yield "a twin that is nowhere", demand(obj), set()
    empty = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.instance_type, empty.instance_collection = "COLLECTION", hidden
    yield "a twin in a collection that is instanced", demand(obj), {"twin"}


def plain_modifiers(demand):
    obj, _, _ = worn()
    displace = obj.modifiers.new("Displace", "DISPLACE")
    obj.vertex_groups.new(name="vg")
    obj.data.uv_layers.new(name="uvs")
    displace.vertex_group, displace.texture_coords, displace.uv_layer = "vg", "UV", "uvs"
    yield "a displace modifier", demand(obj), {"vertex group vg", "uvs"}


def twins(demand):
    obj, _, _ = worn()
    twin = bpy.data.objects.new("Twin", obj.data)
    bpy.context.scene.collection.objects.link(twin)
    twin.material_slots[0].link = "OBJECT"
    twin.material_slots[0].material = shows(new_material(), lambda tree: colour(tree, "twin"))
    yield "a twin of the mesh with a material of its own", demand(obj), {"twin"}


def drivers(demand):
    for number, path in enumerate(('data.attributes["drv"].data[0].value', "data.attributes[0].data[0].value")):
        obj, tree, _ = worn()
        for driven in ("an object's", "a node's"):
            value = tree.nodes.new("ShaderNodeValue")
            curve = (
                obj.driver_add("location", 0)
                if driven == "an object's"
                else value.outputs[0].driver_add("default_value")
            )
            target = curve.driver.variables.new().targets[0]
            target.id, target.data_path = obj, path
            yield f"{driven} driver", demand(obj), {(["drv"], [ALL])[number][0]}
            obj.driver_remove("location")


def unknown_engines(demand):
    class Engine(bpy.types.RenderEngine):
        bl_idname, bl_label = "TEST_ENGINE", "Test"

    bpy.utils.register_class(Engine)
    try:
        obj, _, _ = worn("TEST_ENGINE")
        yield "an engine that nobody knows", demand(obj), {ALL}
    finally:
        bpy.context.scene.render.engine = "CYCLES"
        bpy.utils.unregister_class(Engine)


def rays_of_others(demand):
    if bpy.app.version < (5, 1):
        return
    obj, _, _ = worn()
    tree = new_material("Rays").node_tree
    node = tree.nodes.new("ShaderNodeRaycast")
    node.sample_attribute_items.new("FLOAT", "hit")
    emit(tree, node.outputs["hit"], tree.nodes["Material Output"])
    yield "a ray of another material", demand(obj), {"hit"}


CASES = [
    links_that_count, mixed_colours, mixed_shaders, animated_nodes, groups_used_twice, nested_groups,
    outputs_of_engines, other_outputs, slots_and_overrides, colours_and_uvs, weights_of_zero, scripts_in_shaders,
    named_attributes, names_that_are_given, switches, materials_by_nodes, instances, other_objects,
    objects_in_collections, plain_modifiers, twins, drivers, unknown_engines, rays_of_others,
]  # fmt: skip
