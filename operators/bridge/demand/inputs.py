# SPDX-License-Identifier: GPL-3.0-or-later
"""The inputs of a node that matter: a constant factor or weight of 0 or 1 hides others.

A function `_used_of_TYPE(walk, node, context, inputs)` serves one type of node. It gets the NodeWalk, the node, the
enclosing group nodes (innermost last) and the node's enabled inputs, and returns those inputs that have an effect.
"""

# Weights of the Principled BSDF, and the inputs that a weight of 0 hides.
WEIGHED = {
    "Emission Strength": ("Emission Color",),
    "Coat Weight": ("Coat Roughness", "Coat IOR", "Coat Tint", "Coat Normal"),
    "Sheen Weight": ("Sheen Roughness", "Sheen Tint"),
    "Subsurface Weight": ("Subsurface Radius", "Subsurface Scale", "Subsurface Anisotropy"),
}


def used_inputs(walk, node, context: tuple) -> list:
    """Return the inputs of a node that can change its outputs; all if animation or a driver may change its settings.

    walk: the NodeWalk, which knows constant values. context: enclosing group nodes, the innermost last.
    """
    if walk.is_altered(node):
        return list(node.inputs)
    # a mix or a switch keeps links on the disabled sockets of its other data types
    inputs = [socket for socket in node.inputs if socket.enabled]
    choose = CHOOSING.get(node.bl_idname)
    return choose(walk, node, context, inputs) if choose else inputs


def _used_of_mix(walk, node, context, inputs):
    """Return the used inputs of a Mix node; all where the factor is a vector or mixes rotations."""
    if node.data_type == "ROTATION" or node.data_type == "VECTOR" and node.factor_mode == "NON_UNIFORM":
        return inputs
    # A blend mode such as Multiply reads the first colour even at a factor of 1; MIX then shows the second alone.
    blends = node.data_type == "RGBA" and node.blend_type != "MIX"
    return _used_sides(walk, node, context, inputs, replaces=not blends, clamped=node.clamp_factor)


def _used_of_mix_shader(walk, node, context, inputs):
    """Return the used inputs of a Mix Shader node."""
    return _used_sides(walk, node, context, list(node.inputs)[:3], replaces=True, clamped=True)


def _used_of_mix_colours(walk, node, context, inputs):
    """Return the used inputs of the old Mix RGB node."""
    return _used_sides(walk, node, context, list(node.inputs)[:3], replaces=node.blend_type == "MIX", clamped=True)


def _used_sides(walk, node, context, inputs, replaces: bool, clamped: bool):
    """Return those of a node's inputs, a factor and two sides, that have an effect.

    A constant factor of 0 hides the second side. replaces: a factor of 1 hides the first side, which a blend mode still
    reads. clamped: factors are limited to 0 .. 1. walk: the NodeWalk, which knows constant values.
    """
    if len(inputs) != 3:
        return inputs
    factor, first, second = inputs
    value = walk.constant(node, factor, context)
    if value is None:
        return inputs
    if value == 0 or clamped and value < 0:
        return [first]
    if replaces and (value == 1 or clamped and value > 1):
        return [second]
    return inputs


def _used_of_switch(walk, node, context, inputs):
    """Return the used inputs of a Switch node: one side if its switch is constant."""
    value = walk.constant(node, inputs[0], context) if len(inputs) == 3 else None
    return inputs if value is None else [inputs[2 if value else 1]]  # inputs: switch, false, true


def _used_of_index_switch(walk, node, context, inputs):
    """Return the used inputs of an Index Switch node: one if its index is constant."""
    value = walk.constant(node, inputs[0], context)
    is_in_range = isinstance(value, int) and 0 <= value < len(inputs) - 1
    return [inputs[1 + value]] if is_in_range else inputs  # inputs: index, then its items


def _used_of_principled(walk, node, context, inputs):
    """Return the used inputs of a Principled BSDF, without those that a weight of 0 hides."""
    unused = set()
    for weight, parts in WEIGHED.items():
        if weight in node.inputs and walk.constant(node, node.inputs[weight], context) == 0:
            unused.update(parts)
    return [socket for socket in inputs if socket.name not in unused]


CHOOSING = {
    "ShaderNodeMix": _used_of_mix,
    "ShaderNodeMixRGB": _used_of_mix_colours,
    "ShaderNodeMixShader": _used_of_mix_shader,
    "ShaderNodeBsdfPrincipled": _used_of_principled,
    "GeometryNodeSwitch": _used_of_switch,
    "GeometryNodeIndexSwitch": _used_of_index_switch,
}
