# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of the demo: land, sea, and triangles coloured by their level."""

import math

import bpy

from ...cbt_terrain.mesh.attributes import LEVEL
from ..effects.nodes import Nodes

HAZE = (0.52, 0.66, 0.86, 1.0)
HAZE_DISTANCE_M = 38_000.0
# Coarse to fine: pale stone to deep blue, and what is finest in orange.
LEVEL_COLOURS = ((0.72, 0.71, 0.64), (0.36, 0.56, 0.47), (0.07, 0.33, 0.38), (0.05, 0.10, 0.28), (0.85, 0.22, 0.03))
INK = (0.01, 0.015, 0.04, 1.0)


class LandNodes(Nodes):
    """What the demo's materials are made of."""

    def ramp(self, value, colours):
        node = self.add("ShaderNodeValToRGB", {"Fac": value})
        elements = node.color_ramp.elements
        while len(elements) < len(colours):
            elements.new(0.5)
        for i, colour in enumerate(colours):
            elements[i].position, elements[i].color = i / (len(colours) - 1), (*colour, 1.0)
        return node.outputs["Color"]

    def emission(self, colour, strength: float = 1.0):
        return self.add("ShaderNodeEmission", {"Color": colour, "Strength": strength}).outputs[0]

    def hazy(self, surface):
        """The surface through air: what is far away takes the colour of the horizon."""
        distance = self.add("ShaderNodeCameraData").outputs["View Distance"]
        clear = self.math("POWER", math.e, self.math("DIVIDE", distance, -HAZE_DISTANCE_M))
        inputs = {0: self.math("SUBTRACT", 1.0, clear), 1: surface, 2: self.emission(HAZE, 0.9)}
        return self.add("ShaderNodeMixShader", inputs).outputs[0]

    def finish(self, surface) -> None:
        self.add("ShaderNodeOutputMaterial", {"Surface": surface})


def plain_material(name: str, colour: tuple[float, float, float, float]) -> bpy.types.Material:
    """One colour, whatever the light."""
    material, n = _material(name)
    n.finish(n.emission(colour))
    return material


def _material(name: str) -> tuple[bpy.types.Material, LandNodes]:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, LandNodes(material.node_tree)


def put_haze(material: bpy.types.Material) -> None:
    """Air before the surface of any material."""
    n = LandNodes(material.node_tree)
    output = next(node for node in n.tree.nodes if node.type == "OUTPUT_MATERIAL")
    [link] = output.inputs["Surface"].links
    n.tree.links.new(n.hazy(link.from_socket), output.inputs["Surface"])
    n.arrange()


def sea_material() -> bpy.types.Material:
    material, n = _material("Sea")
    inputs = {"Color": (0.012, 0.055, 0.085, 1), "Roughness": 0.0}
    deep = n.add("ShaderNodeBsdfDiffuse", inputs).outputs[0]
    glint = n.add("ShaderNodeBsdfGlossy", {"Color": (0.9, 0.95, 1.0, 1), "Roughness": 0.22}).outputs[0]
    mirrored = n.add("ShaderNodeFresnel", {"IOR": 1.33}).outputs[0]
    n.finish(n.hazy(n.add("ShaderNodeMixShader", {0: mirrored, 1: deep, 2: glint}).outputs[0]))
    return material


def level_material(coarsest: float, finest: float, sun) -> bpy.types.Material:
    """Each triangle in the colour of its level, shaded a little by the `sun` (unit vector), its edges a pixel wide."""
    material, n = _material("Levels")
    level = n.add("ShaderNodeAttribute", attribute_name=LEVEL).outputs["Fac"]
    inputs = {"Value": level, "From Min": coarsest - 0.5, "From Max": finest + 0.5}
    colour = n.ramp(n.add("ShaderNodeMapRange", inputs).outputs["Result"], LEVEL_COLOURS)
    normal = n.add("ShaderNodeNewGeometry").outputs["Normal"]
    sun = n.add("ShaderNodeVectorMath", {0: normal, 1: tuple(sun)}, operation="DOT_PRODUCT")
    light = n.math("ADD", 0.42, n.math("MULTIPLY", n.math("MAXIMUM", sun.outputs["Value"], 0.0), 1.15))
    shaded = n.add("ShaderNodeVectorMath", {0: colour, "Scale": light}, operation="SCALE").outputs["Vector"]
    line = n.add("ShaderNodeWireframe", {"Size": 0.9}, use_pixel_size=True).outputs[0]
    n.finish(n.emission(n.mix(n.math("MULTIPLY", line, 0.75), shaded, INK)))
    return material
