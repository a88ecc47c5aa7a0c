# SPDX-License-Identifier: GPL-3.0-or-later
"""The node group "Terrain Layers": the layers' colours by their weights, varied, darkened where little sky is seen.

It is built from what there is: as many layers as the terrain has, and of each source the baked map where there is one,
else the attribute. It reads nothing else, so nothing else is computed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count

import bpy

from ...cbt_terrain.attributes.tiling import MARGIN
from ..bridge.demand.trees import tree_of_new
from ..bridge.nodes import Nodes, marked_group_node

GROUP = "Terrain Layers"
PLAIN = (0.2, 0.19, 0.17)  # without any layer
MARK = "adaptive_terrain"  # a property of the group, by which it is found again under any name
FIELDS = 100.0  # default sizes of the variation in the terrain's longer side
LAYERS_PER_SPLAT = 4  # layers whose weights are in one attribute or map: splat_1, splat_2 ...
COLORS, NORMAL, SKY, SUN = "color", "detail_normal", "sky", "sun"
VARIATION, SIZE, OCCLUSION, SHADOW = "Variation", "Variation Size", "Occlusion", "Shadow"
COLOUR = "Color"
# How far noise moves the border of two layers: 0 not at all, 1 until one of them is gone.
RAGGED = 0.9
# The noise in heights is finer, so that cliffs are banded and level ground is not.
BANDED = 6.0
# What the noise does to a colour.
LIGHTER, WARMER = (0.9, 0.85, 0.8), (0.14, 0.02, -0.14)
# Width of the ground along a seam of tiles that is read without mipmaps, as a fraction of its distance to the camera.
SEAM = 0.01
# Octaves of the variation, in its size; the distance at which an octave is half as strong, in the octave's size.
BROAD, FINE, SEEN = 3.0, 0.12, 500.0
# Largest tufts of grass, metres; how often they halve at most; the smallest one, as a fraction of its distance to the
# camera; what each halving that is seen adds to a colour.
TUFT, OCTAVES, PIXEL, TUFTED = 1.5, 5.0, 0.0015, (0.17, 0.16, 0.14)


@dataclass(frozen=True)
class LayerSources:
    """Inputs of the group.

    `layers`: name and colour (linear RGB) of each, none where there is a map of COLORS. `light`: which of SKY and SUN
    darken the colours. `maps`: baked images by attribute; attributes without one are read from the mesh. `place`: adds
    nodes to a tree that give the position in a map; returns their output. `tile`: metres of the world across one tile
    of a map.
    """

    layers: Sequence[tuple[str, tuple[float, float, float]]]
    light: Sequence[str] = ()
    maps: Mapping[str, bpy.types.Image] = field(default_factory=dict)
    place: Callable[[bpy.types.NodeTree], bpy.types.NodeSocket] | None = None
    tile: float = 0.0


def give_terrain_material(obj, sources: LayerSources) -> bpy.types.Material:
    """Give the object a material with the group, or rebuild the group of the material that it has; return the material.

    A material that an object with another mesh uses, or that is linked from a file, is copied first. The inputs of the
    layers get their colours; other inputs and links stay. The group's normal is linked to shaders without one.
    sources: the layers, light and maps that the group reads.
    """
    material, node = _find_group(obj) or _create_material(obj)
    names = _socket_names([name for name, _ in sources.layers])
    layers = [(name, colour) for name, (_, colour) in zip(names, sources.layers, strict=True)]
    sources = replace(sources, layers=layers)
    low, high = obj.bound_box[0], obj.bound_box[6]  # opposite corners of the box
    side = max(high[0] - low[0], high[1] - low[1])
    names_before = set(node.inputs.keys())
    variation_size = side / FIELDS if side > 0 else 1.0  # default, in metres
    build_group(node.node_tree, sources, variation_size)
    for item in _input_sockets(node.node_tree):
        if item.name not in names_before:  # the node's own socket was made before the interface had its default
            node.inputs[item.name].default_value = item.default_value
    for name, colour in sources.layers:
        node.inputs[name].default_value = (*colour, 1.0)
    tree, normal = material.node_tree, node.outputs.get("Normal")
    for shader in {link.to_node for link in node.outputs[COLOUR].links} if normal is not None else ():
        if "Normal" in shader.inputs and not shader.inputs["Normal"].is_linked:
            tree.links.new(normal, shader.inputs["Normal"])
    return material


def new_plain_material(name: str, color: tuple[float, float, float], size: float) -> bpy.types.Material:
    """Create a material of one color, linear RGB, with the variation of a terrain's layers, of `size` metres."""
    material = bpy.data.materials.new(name)
    material.diffuse_color = *color, 1.0
    tree = tree_of_new(material)
    tree.nodes.clear()
    n = Nodes(tree)
    variation, length = n.add("ShaderNodeValue", label=VARIATION), n.add("ShaderNodeValue", label=SIZE)
    variation.outputs[0].default_value, length.outputs[0].default_value = 0.5, size
    noise = _add_noise(n, length.outputs[0])
    if _is_grass(color):
        color = n.vector("MULTIPLY", color, _add_tufts(n, length.outputs[0], variation.outputs[0]))
    varied = _add_variation(n, color, noise, variation.outputs[0])
    inputs = {"Base Color": varied, "Roughness": 0.9, "Specular IOR Level": 0.2}
    n.add("ShaderNodeOutputMaterial", {"Surface": n.add("ShaderNodeBsdfPrincipled", inputs).outputs[0]})
    n.arrange()
    return material


def has_layers_group(obj) -> bool:
    """Return whether a material of the object has the node group."""
    return any(shows_layers(slot.material) for slot in obj.material_slots)


def shows_layers(material) -> bool:
    """Return whether a material has the node group."""
    return marked_group_node(material, MARK) is not None


def has_no_material(obj) -> bool:
    """Return whether the object has no material."""
    return all(slot.material is None for slot in obj.material_slots)


def _find_group(obj) -> tuple[bpy.types.Material, bpy.types.Node] | None:
    """Return the object's first material that has the group, and the group's node, as copies if they are shared.

    None without one.
    """
    for slot in obj.material_slots:
        node = marked_group_node(slot.material, MARK)
        if node is not None:
            if slot.material.library is not None or _is_used_by_others(slot.material, obj):
                slot.material = copy_material(slot.material)
                node = marked_group_node(slot.material, MARK)
            return slot.material, node
    return None


def copy_material(material) -> bpy.types.Material:
    """Return a copy of a material, with a copy of the node group if it has one: another terrain's layers change it."""
    copied = material.copy()
    node = marked_group_node(copied, MARK)
    if node is not None:
        node.node_tree = node.node_tree.copy()
    return copied


def _is_used_by_others(material, obj) -> bool:
    """Return whether an object with another mesh uses the material."""
    others = (other for other in bpy.data.objects if other.data != obj.data)
    return any(slot.material == material for other in others for slot in other.material_slots)


def _create_material(obj) -> tuple[bpy.types.Material, bpy.types.Node]:
    """Create a material with an empty group in the object's first slot; return it and the group's node."""
    material = bpy.data.materials.new(f"{obj.name} Material")
    tree = tree_of_new(material)
    tree.nodes.clear()
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    group[MARK] = True
    group.interface.new_socket(COLOUR, in_out="OUTPUT", socket_type="NodeSocketColor")
    n = Nodes(tree)
    node = n.add("ShaderNodeGroup", node_tree=group)
    inputs = {"Base Color": node.outputs[COLOUR], "Roughness": 0.9, "Specular IOR Level": 0.2}
    n.add("ShaderNodeOutputMaterial", {"Surface": n.add("ShaderNodeBsdfPrincipled", inputs).outputs[0]})
    n.arrange()
    node.width = 200.0
    if obj.material_slots:
        obj.material_slots[0].material = material  # of the object or of its mesh, as the slot has it
    else:
        obj.data.materials.append(material)
    return material, node


def _socket_names(names: Sequence[str]) -> list[str]:
    """Return a socket name for each layer, unique among the layers and the group's other sockets."""
    names_in_use = [VARIATION, SIZE, OCCLUSION, SHADOW]
    for name in names:
        numbered = (f"{name or 'Layer'} {number}" for number in count(2))
        names_in_use.append(next(free for free in chain([name or "Layer"], numbered) if free not in names_in_use))
    return names_in_use[4:]  # without the four other sockets


def build_group(tree, sources: LayerSources, size: float) -> None:
    """Build the nodes of the group `tree` anew; links to its inputs stay.

    sources: layers (name and colour) with names that are unique among all sockets, none with a baked map of all colours
    (COLORS); light: which of SKY and SUN darken. size: default of the input Variation Size, metres.
    """
    names = [name for name, _ in sources.layers]
    strengths = {SKY: OCCLUSION, SUN: SHADOW}  # input that sets how much each darkens
    inputs = {name: "NodeSocketColor" for name in names}
    inputs |= {name: "NodeSocketFloat" for name in (VARIATION, SIZE, *(strengths[name] for name in sources.light))}
    outputs = {COLOUR: "NodeSocketColor"} | ({"Normal": "NodeSocketVector"} if NORMAL in sources.maps else {})
    _set_interface(tree, inputs, outputs)
    tree.nodes.clear()
    n = Nodes(tree)
    group_inputs = n.add("NodeGroupInput").outputs
    noise = _add_noise(n, group_inputs[SIZE])
    layers = [group_inputs[name] for name in names]
    if grass := [number for number, (_, given) in enumerate(sources.layers) if _is_grass(given)]:
        tufts = _add_tufts(n, group_inputs[SIZE], group_inputs[VARIATION])
        for number in grass:
            layers[number] = n.vector("MULTIPLY", layers[number], tufts)
    colour = _add_mixture(n, sources, layers, noise) if names else PLAIN
    if COLORS in sources.maps:
        colour = _add_map(n, sources, COLORS)["Color"]
    colour = _add_variation(n, colour, noise, group_inputs[VARIATION])
    for name in sources.light:  # colour * (1 - strength * (1 - seen))
        seen, strength = _add_value(n, sources, name), group_inputs[strengths[name]]
        factor = n.math("SUBTRACT", 1.0, n.math("MULTIPLY", strength, n.math("SUBTRACT", 1.0, seen)))
        colour = n.scaled(colour, factor)
    out = n.add("NodeGroupOutput", {COLOUR: colour})
    if NORMAL in sources.maps:
        normal = n.add("ShaderNodeNormalMap", {"Color": _add_map(n, sources, NORMAL)["Color"]}, space="OBJECT")
        tree.links.new(normal.outputs[0], out.inputs["Normal"])
    n.arrange()
    for item in _input_sockets(tree):
        if item.socket_type == "NodeSocketFloat":
            item.min_value, item.max_value = 0.0, 1e6 if item.name == SIZE else 1.0
            item.default_value = {VARIATION: 0.5, SIZE: size, OCCLUSION: 0.4, SHADOW: 0.0}[item.name]


def _set_interface(tree, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> None:
    """Give the group these sockets in this order; those that it has already stay with their links, others are removed.

    inputs, outputs: socket type by name.
    """
    for panel in [item for item in tree.interface.items_tree if item.item_type == "PANEL"]:
        tree.interface.remove(panel)
    sockets = [(name, kind, "OUTPUT") for name, kind in outputs.items()]  # Blender keeps them before the inputs
    sockets += [(name, kind, "INPUT") for name, kind in inputs.items()]
    existing = {(item.name, item.socket_type, item.in_out): item for item in tree.interface.items_tree}
    for key in existing.keys() - set(sockets):
        tree.interface.remove(existing[key])
    for position, (name, kind, in_out) in enumerate(sockets):
        item = existing.get((name, kind, in_out)) or tree.interface.new_socket(name, in_out=in_out, socket_type=kind)
        tree.interface.move(item, position)


def _input_sockets(tree) -> list:
    """Return the input sockets of a group's interface."""
    items = tree.interface.items_tree
    return [item for item in items if item.item_type == "SOCKET" and item.in_out == "INPUT"]


def _add_value(n: Nodes, sources: LayerSources, name: str):
    """Add nodes that read one number of the attribute `name`, from its baked map if `sources` has one; return the
    output.
    """
    if name in sources.maps:
        return n.add("ShaderNodeSeparateColor", {0: _add_map(n, sources, name)["Color"]}).outputs[0]
    return n.add("ShaderNodeAttribute", attribute_name=name).outputs["Fac"]


def _add_map(n: Nodes, sources: LayerSources, name: str):
    """Add nodes that read the map of the attribute `name`, which `sources` has; return outputs "Color" and "Alpha".

    At the border of two tiles EEVEE takes the jump from one tile to the other for a derivative, and shows the mean
    of a whole tile in a line of a pixel or two. So the image is read there without mipmaps, with cubic
    interpolation.
    """
    place = sources.place(n.tree) if sources.place else None  # socket: position in tiles; None: the active UV map
    inputs = {"Vector": place} if place else {}
    settings = {"image": sources.maps[name], "extension": "EXTEND"}
    usual = n.add("ShaderNodeTexImage", inputs, **settings).outputs
    if place is None or settings["image"].source != "TILED":
        return {name: usual[name] for name in ("Color", "Alpha")}
    cubic = n.add("ShaderNodeTexImage", inputs, interpolation="Cubic", **settings).outputs
    near = _add_seam_mask(n, place, sources.tile)
    alpha = n.math("MULTIPLY_ADD", near, n.math("SUBTRACT", cubic["Alpha"], usual["Alpha"]), usual["Alpha"])
    return {"Color": n.mix(near, usual["Color"], cubic["Color"]), "Alpha": alpha}


def _add_seam_mask(n: Nodes, place, tile: float):
    """Add nodes that give 1 within a few pixels of the border between tiles of `tile` metres, else 0.

    place: output socket of the position in tiles: the tile's number plus a place in it, MARGIN .. 1 - MARGIN, since an
    image has a margin of its neighbours' ground. Returns the output socket of the number. Distances are in tiles.
    """
    from_middle = n.vector("ABSOLUTE", n.vector("SUBTRACT", n.vector("FRACTION", place), (0.5, 0.5, 0.5)))
    x, y, _ = n.add("ShaderNodeSeparateXYZ", {0: from_middle}).outputs
    from_border = n.math("SUBTRACT", 0.5 - MARGIN, n.math("MAXIMUM", x, y))
    from_camera = n.add("ShaderNodeCameraData").outputs["View Distance"]  # metres
    return n.math("LESS_THAN", from_border, n.math("MULTIPLY", from_camera, SEAM / max(tile, 1e-9)))


def _add_weights(n: Nodes, sources: LayerSources, group: int):
    """Add nodes that read the weights of four layers; return two sockets: three as a colour, and the fourth as alpha.

    group: number of the four, from 0: the attribute `splat_1`, or its map if `sources` has one, has the first ones.
    """
    name = f"splat_{group + 1}"
    if name in sources.maps:
        outputs = _add_map(n, sources, name)
    else:
        outputs = n.add("ShaderNodeAttribute", attribute_name=name).outputs
    return outputs["Color"], outputs["Alpha"]


def _add_noise(n: Nodes, size):
    """Add two octaves of noise; return a vector of three different mixtures, about -1 .. 1 each.

    size: metres. Each octave fades with distance, so that it does not flicker: at SEEN times its length it is half as
    strong. The mixtures are the sum, its opposite and the difference of the octaves. They change BANDED times as fast
    with height, like strata.
    """
    place = n.vector("MULTIPLY", n.add("ShaderNodeTexCoord").outputs["Object"], (1.0, 1.0, BANDED))
    from_camera = n.add("ShaderNodeCameraData").outputs["View Distance"]
    octaves = []
    for factor in (BROAD, FINE):
        length = n.math("MULTIPLY", size, factor)
        inputs = {"Vector": n.vector("DIVIDE", place, length), "Scale": 1.0, "Detail": 4.0, "Roughness": 0.7}
        noise = n.math("SUBTRACT", n.add("ShaderNodeTexNoise", inputs).outputs[0], 0.5)
        fading = n.math("POWER", 0.5, n.math("DIVIDE", from_camera, n.math("MULTIPLY", length, SEEN)))
        octaves.append(n.math("MULTIPLY", noise, n.math("MULTIPLY", fading, 4.0)))  # 4: up to about 1
    both = n.math("ADD", *octaves)
    inputs = {0: both, 1: n.math("MULTIPLY", both, -1.0), 2: n.math("SUBTRACT", *octaves)}
    return n.add("ShaderNodeCombineXYZ", inputs).outputs[0]


def _is_grass(colour) -> bool:
    """Return whether a layer's colour, linear RGB, is a green of plants: neither yellow nor that of water."""
    red, green, blue = colour
    return green > red and green > 1.5 * blue


def _add_tufts(n: Nodes, size, variation):
    """Add noise for grass near the camera; return a factor of its colour, 0.3 at least.

    size: socket of the variation's size in metres, which limits the tufts on small land. variation: socket of the
    strength, 0 .. 1. Tufts smaller than a pixel are left out, so that they cost little and do not flicker.
    """
    from_camera = n.add("ShaderNodeCameraData").outputs["View Distance"]
    length = n.math("MINIMUM", size, TUFT)
    pixels = n.math("DIVIDE", length, n.math("MULTIPLY", from_camera, PIXEL))  # across the largest tuft
    octaves = n.math("MAXIMUM", n.math("MINIMUM", n.math("LOGARITHM", pixels, 2.0), OCTAVES), 0.0)
    place = n.vector("DIVIDE", n.add("ShaderNodeTexCoord").outputs["Object"], length)
    inputs = {"Vector": place, "Scale": 1.0, "Detail": octaves, "Roughness": 1.0}
    noise = n.add("ShaderNodeTexNoise", inputs, noise_dimensions="2D", normalize=False).outputs[0]  # about 0
    strength = n.math("MULTIPLY", variation, n.math("MULTIPLY", octaves, noise))
    return n.vector("MAXIMUM", n.vector("ADD", (1.0, 1.0, 1.0), n.scaled(TUFTED, strength)), (0.3, 0.3, 0.3))


def _add_mixture(n: Nodes, sources: LayerSources, colours: Sequence, noise):
    """Add nodes that mix the layers' colours by their weights; the noise makes the borders ragged.

    n: adds nodes to the tree. sources: has the maps of the weights, if they are baked. colours: output sockets, one for
    each layer. noise: result of `_add_noise`. Returns the output socket of the mixed colour.
    """
    # Factors of the weights about 1: of the first three layers of a group, and of the fourth, opposite to the first.
    three = n.vector("MULTIPLY_ADD", noise, (RAGGED, RAGGED, RAGGED), (1.0, 1.0, 1.0))
    three = n.vector("MAXIMUM", three, (1.0 - RAGGED,) * 3)
    opposite = n.math("SUBTRACT", 2.0, n.add("ShaderNodeSeparateXYZ", {0: three}).outputs[0])
    fourth = n.math("MAXIMUM", opposite, 1.0 - RAGGED)
    colour = total = None
    for first in range(0, len(colours), LAYERS_PER_SPLAT):
        vector, alpha = _add_weights(n, sources, first // LAYERS_PER_SPLAT)
        weights = list(n.add("ShaderNodeSeparateXYZ", {0: n.vector("MULTIPLY", vector, three)}).outputs)
        weights.append(n.math("MULTIPLY", alpha, fourth))
        for weight, layer in zip(weights, colours[first : first + LAYERS_PER_SPLAT], strict=False):
            weighted = n.scaled(layer, weight)
            colour = weighted if colour is None else n.vector("ADD", colour, weighted)
            total = weight if total is None else n.math("ADD", total, weight)
    return n.scaled(colour, n.math("DIVIDE", 1.0, n.math("MAXIMUM", total, 1e-6)))


def _add_variation(n: Nodes, colour, noise, variation):
    """Add nodes that make a colour lighter or darker, warmer or colder by the noise; return the colour.

    noise: result of `_add_noise`, of which the first and the third mixture are used. variation: socket of the strength,
    0 .. 1. The factors of the colour are 0.15 at least, so that nothing is black.
    """
    first, _, third = n.add("ShaderNodeSeparateXYZ", {0: noise}).outputs
    grey, warm = n.scaled(LIGHTER, first), n.scaled(WARMER, third)
    factor = n.vector("ADD", (1.0, 1.0, 1.0), n.scaled(n.vector("ADD", grey, warm), variation))
    return n.vector("MULTIPLY", colour, n.vector("MAXIMUM", factor, (0.15, 0.15, 0.15)))
