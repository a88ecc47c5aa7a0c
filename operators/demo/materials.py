# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of the demo: land, sea, and triangles coloured by their level."""

import math

import bpy

from ...cbt_terrain.mesh.attributes import LEVEL
from ..bridge.demand.trees import tree_of_new
from ..bridge.nodes import Nodes

# The sky at the horizon away from the sun and towards it, and at the zenith.
AWAY, SUNWARD, ZENITH = (0.40, 0.53, 0.72, 1.0), (1.00, 0.80, 0.60, 1.0), (0.055, 0.15, 0.40, 1.0)
# Metres of air that absorb 63 % of red, green and blue light.
AIR_M = (90_000.0, 60_000.0, 34_000.0)
DEEP, SHALLOW, FOAM = (0.004, 0.020, 0.032, 1.0), (0.050, 0.135, 0.120, 1.0), (0.75, 0.78, 0.80, 1.0)
# Metres of water that hide the ground to 63 %.
CLEAR_M = 3.5
SKY_STRENGTH = 0.8
WATER_DEPTH = "water_depth"
SEA_ROUGHNESS = 0.28  # below 0.274 Cycles' denoiser follows the speckled reflections
GRAIN_M, GRAIN_CONTRAST = 16.0, 2.0  # size of the largest grain, and its effect on colours
# Coarse to fine: pale stone to deep blue, then orange.
LEVEL_COLOURS = ((0.72, 0.71, 0.64), (0.36, 0.56, 0.47), (0.07, 0.33, 0.38), (0.05, 0.10, 0.28), (0.85, 0.22, 0.03))
INK = (0.01, 0.015, 0.04, 1.0)


class LandNodes(Nodes):
    """Node helpers for the demo's materials."""

    def ramp(self, value, colours):
        """Add a colour ramp of evenly spaced colours, RGB and two at least, for a value 0 .. 1; return the colour."""
        node = self.add("ShaderNodeValToRGB", {"Fac": value})
        elements = node.color_ramp.elements
        while len(elements) < len(colours):
            elements.new(0.5)
        for i, colour in enumerate(colours):
            elements[i].position, elements[i].color = i / (len(colours) - 1), (*colour, 1.0)
        return node.outputs["Color"]

    def emission(self, colour, strength: float = 1.0):
        """Add a shader of one colour that ignores light; return it."""
        return self.add("ShaderNodeEmission", {"Color": colour, "Strength": strength}).outputs[0]

    def smooth(self, value, low: float, high: float):
        """Return a smoothstep that is 0 at `low` and beyond, 1 at `high` and beyond; `low` may be the larger one."""
        limits = {"Value": value, "From Min": low, "From Max": high}
        return self.add("ShaderNodeMapRange", limits, interpolation_type="SMOOTHSTEP").outputs["Result"]

    def horizon(self, direction, sun):
        """Return the colour of the air in a direction, warmer towards the sun (both unit vectors)."""
        towards = self.vector("DOT_PRODUCT", direction, tuple(sun))
        return self.mix(self.math("POWER", self.smooth(towards, -0.4, 1.0), 2.5), AWAY, SUNWARD)

    def with_haze(self, surface, sun):
        """Return a surface shader with aerial perspective: air absorbs its light and adds light of the sky.

        surface: the shader's socket. sun: unit vector towards it.
        """
        distance = self.add("ShaderNodeCameraData").outputs["View Distance"]
        # The fractions of red, green and blue light that the air absorbs.
        absorbed = [
            self.math("SUBTRACT", 1.0, self.math("POWER", math.e, self.math("DIVIDE", distance, -length)))
            for length in AIR_M
        ]
        # A mix of shaders has one factor, that of green; the air's colour holds the ratios of red and blue to it.
        ratios = [self.math("DIVIDE", part, self.math("MAXIMUM", absorbed[1], 1e-6)) for part in absorbed]
        tint = self.add("ShaderNodeCombineXYZ", dict(enumerate(ratios))).outputs[0]
        ahead = self.scaled(self.add("ShaderNodeNewGeometry").outputs["Incoming"], -1.0)
        air = self.emission(self.vector("MULTIPLY", self.horizon(ahead, sun), tint), SKY_STRENGTH)
        return self.add("ShaderNodeMixShader", {0: absorbed[1], 1: surface, 2: air}).outputs[0]

    def finish(self, surface) -> None:
        """Link a shader to the material's output."""
        self.add("ShaderNodeOutputMaterial", {"Surface": surface})


def plain_material(name: str, colour: tuple[float, float, float, float]) -> bpy.types.Material:
    """Return a material of one colour that ignores light."""
    material, n = _new_material(name)
    n.finish(n.emission(colour))
    return material


def _new_material(name: str) -> tuple[bpy.types.Material, LandNodes]:
    """Create a material without nodes; return it and helpers that add nodes to it."""
    material = bpy.data.materials.new(name)
    tree = tree_of_new(material)
    tree.nodes.clear()
    return material, LandNodes(tree)


def put_grain(material: bpy.types.Material) -> None:
    """Add stones and tufts finer than samples and texels to a material's colour and shading; snow hides them.

    The material has a Principled BSDF; a base colour that is not linked stays as it is.
    """
    n = LandNodes(material.node_tree)
    shader = next(node for node in n.tree.nodes if node.type == "BSDF_PRINCIPLED")
    inputs = {"Vector": n.add("ShaderNodeTexCoord").outputs["Object"], "Scale": 1.0 / GRAIN_M, "Detail": 5.0}
    grain = n.add("ShaderNodeTexNoise", inputs | {"Roughness": 0.72}).outputs[0]
    bump = n.add("ShaderNodeBump", {"Height": grain, "Strength": 0.9, "Distance": 0.3 * GRAIN_M})
    for link in shader.inputs["Normal"].links:
        n.tree.links.new(link.from_socket, bump.inputs["Normal"])
    n.tree.links.new(bump.outputs[0], shader.inputs["Normal"])
    snow = n.smooth(n.add("ShaderNodeAttribute", attribute_name="snow").outputs["Fac"], 0.2, 0.8)
    n.tree.links.new(n.math("MULTIPLY_ADD", snow, -0.35, 0.9), shader.inputs["Roughness"])
    contrast = n.math("MULTIPLY_ADD", snow, 0.1 - GRAIN_CONTRAST, GRAIN_CONTRAST)
    shade = n.math("MULTIPLY_ADD", n.math("SUBTRACT", grain, 0.5), contrast, 1.0)
    for link in shader.inputs["Base Color"].links:
        n.tree.links.new(n.scaled(link.from_socket, shade), shader.inputs["Base Color"])


def put_haze(material: bpy.types.Material, sun) -> None:
    """Add aerial perspective to a material whose output has a surface. sun: unit vector towards it."""
    n = LandNodes(material.node_tree)
    output = next(node for node in n.tree.nodes if node.type == "OUTPUT_MATERIAL")
    [link] = output.inputs["Surface"].links
    n.tree.links.new(n.with_haze(link.from_socket, sun), output.inputs["Surface"])
    n.arrange()


def water_material(sun) -> bpy.types.Material:
    """Return a water material: darker with the attribute WATER_DEPTH, with foam, gusts and aerial perspective.

    sun: unit vector towards it.
    """
    material, n = _new_material("Water")
    depth = n.add("ShaderNodeAttribute", attribute_name=WATER_DEPTH).outputs["Fac"]
    place = n.add("ShaderNodeNewGeometry").outputs["Position"]

    def noise(metres: float, detail: float):
        """Add noise with features of a size in metres; return its value."""
        inputs = {"Vector": n.scaled(place, 1.0 / metres), "Scale": 1.0, "Detail": detail}
        return n.add("ShaderNodeTexNoise", inputs).outputs[0]

    clear = n.math("POWER", math.e, n.math("DIVIDE", depth, -CLEAR_M))
    body = n.mix(clear, DEEP, SHALLOW)
    surf = n.math("ADD", depth, n.math("MULTIPLY", noise(26.0, 3.0), 2.6))
    body = n.mix(n.smooth(surf, 1.8, 1.2), body, FOAM)  # none where depth plus noise is above 1.8 m
    under = n.add("ShaderNodeBsdfDiffuse", {"Color": body}).outputs[0]
    rough = n.math("MULTIPLY_ADD", n.smooth(noise(900.0, 4.0), 0.4, 0.65), 0.10, SEA_ROUGHNESS)
    over = n.add("ShaderNodeBsdfGlossy", {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": rough}).outputs[0]
    mirrored = n.math("MULTIPLY", n.add("ShaderNodeFresnel", {"IOR": 1.33}).outputs[0], 0.75)
    n.finish(n.with_haze(n.add("ShaderNodeMixShader", {0: mirrored, 1: under, 2: over}).outputs[0], sun))
    return material


def level_material(coarsest: float, finest: float, sun) -> bpy.types.Material:
    """Return a material that colours triangles by level, with edges and some shading.

    coarsest, finest: levels at the ends of the colours. sun: unit vector towards it.
    """
    material, n = _new_material("Levels")
    level = n.add("ShaderNodeAttribute", attribute_name=LEVEL).outputs["Fac"]
    inputs = {"Value": level, "From Min": coarsest - 0.5, "From Max": finest + 0.5}
    colour = n.ramp(n.add("ShaderNodeMapRange", inputs).outputs["Result"], LEVEL_COLOURS)
    normal = n.add("ShaderNodeNewGeometry").outputs["Normal"]
    facing = n.vector("DOT_PRODUCT", normal, tuple(sun))
    light = n.math("ADD", 0.42, n.math("MULTIPLY", n.math("MAXIMUM", facing, 0.0), 1.15))
    shaded = n.scaled(colour, light)
    line = n.add("ShaderNodeWireframe", {"Size": 0.9}, use_pixel_size=True).outputs[0]
    n.finish(n.emission(n.mix(n.math("MULTIPLY", line, 0.75), shaded, INK)))
    return material
