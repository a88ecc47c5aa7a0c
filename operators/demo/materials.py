# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of the demo: land, sea, and triangles coloured by their level."""

import math

import bpy
import numpy as np

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


def land_material(heights: np.ndarray, step_m: float) -> bpy.types.Material:
    """Sand, meadow, rock and snow as a texture, from heights (float32 [rows, columns], metres, `step_m` apart).

    A texture is looked up in a fraction of the time that procedural nodes take at every ray.
    """
    colours = land_colours(heights, step_m)
    rows, columns = heights.shape
    image = bpy.data.images.new("Land", columns, rows)
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[:, :, :3] = np.clip(colours, 0.0, 1.0) ** (1 / 2.2)  # eight bits hold sRGB better than linear light
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    material, n = _material("Land")
    texture = n.add("ShaderNodeTexImage", image=image, extension="EXTEND").outputs["Color"]
    surface = n.add("ShaderNodeBsdfDiffuse", {"Color": texture, "Roughness": 0.6}).outputs[0]
    n.finish(n.hazy(surface))
    return material


def land_colours(heights: np.ndarray, step_m: float) -> np.ndarray:
    """float32 [rows, columns, 3], linear: sand at the shore, meadows, rock where it is steep, snow on top."""
    top = float(heights.max())
    north, east = np.gradient(heights, step_m)
    flat = 1.0 / np.sqrt(1.0 + north * north + east * east)
    random = np.random.default_rng(3)
    broad, fine = smooth_noise(random, heights.shape, 48), smooth_noise(random, heights.shape, 4)
    level = heights + 0.10 * top * broad
    flat = flat + 0.04 * fine
    strata = 0.5 + 0.3 * np.sin(heights / 9.0 + 5.0 * broad + 0.6 * fine) + 0.2 * np.sin(heights / 3.7 + 9.0 * broad)

    def between(value, low: float, high: float) -> np.ndarray:
        t = np.clip((value - low) / (high - low), 0.0, 1.0)
        return (t * t * (3.0 - 2.0 * t))[:, :, None]

    def mix(part, a, b):
        return a + part * (np.asarray(b, np.float32) - a)

    grain = (0.5 + 0.5 * np.clip(fine, -1, 1))[:, :, None]
    forest = mix(grain, np.array([0.022, 0.050, 0.014]), [0.055, 0.095, 0.026])
    meadow = mix(grain, np.array([0.085, 0.125, 0.032]), [0.125, 0.150, 0.048])
    green = mix(between(flat + 0.05 * broad, 0.88, 0.98), forest, meadow)
    green = mix(between(level, 0.30 * top, 0.55 * top), green, [0.17, 0.15, 0.08])
    ground = mix(between(heights, 0.003 * top, 0.012 * top), np.array([0.46, 0.38, 0.25]), green)
    rock = mix(0.65 * grain + 0.35 * strata[:, :, None], np.array([0.105, 0.093, 0.084]), [0.30, 0.265, 0.235])
    colour = mix(between(flat, 0.70, 0.80), rock, ground)
    snow = between(level, 0.50 * top, 0.62 * top) * between(flat, 0.50, 0.62)
    return mix(snow, colour, [0.80, 0.83, 0.88]).astype(np.float32)


def smooth_noise(random, shape: tuple[int, int], size: int) -> np.ndarray:
    """Noise of about -1 .. 1 in three octaves, the broadest of about `size` samples; float32."""
    total = np.zeros(shape, np.float32)
    for octave in range(3):
        cell = max(1, size >> octave)
        rows, columns = -(-shape[0] // cell) + 2, -(-shape[1] // cell) + 2
        coarse = random.standard_normal((rows, columns)).astype(np.float32)
        y, x = np.arange(shape[0]) / cell, np.arange(shape[1]) / cell
        i, j = y.astype(int), x.astype(int)
        s, t = (y - i)[:, None].astype(np.float32), (x - j)[None].astype(np.float32)
        s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
        upper = coarse[i][:, j] * (1 - t) + coarse[i][:, j + 1] * t
        lower = coarse[i + 1][:, j] * (1 - t) + coarse[i + 1][:, j + 1] * t
        total += (upper * (1 - s) + lower * s) * 0.5**octave
    return total / 1.75


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
