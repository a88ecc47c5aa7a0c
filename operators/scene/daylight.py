# SPDX-License-Identifier: GPL-3.0-or-later
"""A sun lamp and a physical sky around it.

Strengths are chosen so that sunlit snow has a radiance of about 1: the picture needs no exposure, whatever the view
transform.
"""

import math

import bpy
import numpy as np
from mathutils import Vector

from ..bridge.demand.trees import tree_of_new
from ..bridge.nodes import Nodes
from . import built
from .built import remember_built

SUN, SKY = "Terrain Sun", "Terrain Sky"
SUN_STRENGTH, SUN_DISC_DEG = 6.0, 0.545  # W/m^2 at right angles, degrees
# Of a new sun, radians: height above the horizon, and direction clockwise from that of the camera.
ELEVATION, TURN = math.radians(24.0), math.radians(-78.0)
WARM = (1.0, 0.78, 0.52)  # a sun at the horizon, relative to white
WHITE_ELEVATION = math.radians(40.0)
# Types of sky, the best first: since Blender 5.0, and before. Each with the strength that makes about 1 W/m^2 on level
# ground while the sun is 28 degrees high.
SKY_TYPES = {"MULTIPLE_SCATTERING": 0.08, "NISHITA": 0.11}
# Haze at the horizon and below, by the sun's elevation: its radiance, and its color from warm to cool.
ELEVATIONS, RADIANCE = np.radians((2.0, 8.0, 15.0, 28.0)), (0.18, 0.4, 0.55, 0.65)
WARM_HAZE, COOL_HAZE = (1.25, 0.95, 0.72), (0.82, 1.0, 1.18)
FADE = -0.01, 0.12  # sines of the angles above the horizon between which the haze's colour becomes the sky's


def sun_vector(elevation: float, azimuth: float) -> Vector:
    """Return the unit vector towards a sun; both angles in radians, `azimuth` clockwise from +Y."""
    horizontal = math.cos(elevation)
    return Vector((math.sin(azimuth) * horizontal, math.cos(azimuth) * horizontal, math.sin(elevation)))


def add_sun(scene, elevation: float, azimuth: float):
    """Add a sun lamp, warmer the lower it stands, and return its object. The scene remembers it (`find_built`).

    Both angles are radians, `azimuth` clockwise from +Y.
    """
    lamp = bpy.data.lights.new(SUN, "SUN")
    lamp.energy, lamp.angle = SUN_STRENGTH, math.radians(SUN_DISC_DEG)
    white = min(max(elevation / WHITE_ELEVATION, 0.0), 1.0)
    lamp.color = [low + (1.0 - low) * math.sqrt(white) for low in WARM]
    sun = bpy.data.objects.new(SUN, lamp)
    sun.matrix_world = sun_vector(elevation, azimuth).to_track_quat("Z", "Y").to_matrix().to_4x4()
    remember_built(scene, built.SUN, sun)
    scene.collection.objects.link(sun)
    return sun


def haze_color(elevation: float) -> list[float]:
    """Return the color of the haze for a sun's elevation of 0 or more radians, linear RGB times its radiance."""
    radiance = float(np.interp(elevation, ELEVATIONS, RADIANCE))
    cool = min(elevation / ELEVATIONS[-1], 1.0)  # 0 for a sun at the horizon, 1 for a high one
    return [radiance * (warm + (cold - warm) * cool) for warm, cold in zip(WARM_HAZE, COOL_HAZE, strict=True)]


def add_sky(scene, towards: Vector) -> None:
    """Give the scene a new world with a sky whose sun is in the direction `towards`, a unit vector.

    A sun below the horizon is put on it. The haze of the horizon continues below it, where the terrain ends. The new
    world replaces the scene's old one, which stays in the file only if it has other users.
    """
    world = bpy.data.worlds.new(SKY)
    remember_built(scene, built.SKY, world)
    # The sky is smooth without the sun's disc: Cycles' own choice, a map of 2048 pixels, takes ten seconds to make.
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    tree = tree_of_new(world)
    tree.nodes.clear()
    n = Nodes(tree)
    up = n.add("ShaderNodeSeparateXYZ", {0: n.add("ShaderNodeTexCoord").outputs["Generated"]}).outputs["Z"]
    sky = n.add("ShaderNodeTexSky")
    kinds = {item.identifier for item in sky.bl_rna.properties["sky_type"].enum_items}
    sky.sky_type = next(kind for kind in SKY_TYPES if kind in kinds)
    sky.sun_disc = False  # the lamp is the sun
    sky.sun_elevation = max(math.asin(max(-1.0, min(1.0, towards.z))), 0.0)
    sky.sun_rotation = math.atan2(towards.x, towards.y)
    limits = {"Value": up, "From Min": FADE[0], "From Max": FADE[1]}
    above = n.add("ShaderNodeMapRange", limits, interpolation_type="SMOOTHSTEP").outputs["Result"]
    light = n.scaled(sky.outputs[0], SKY_TYPES[sky.sky_type])  # by the strength that suits this type
    inputs = {"Color": n.mix(above, (*haze_color(sky.sun_elevation), 1.0), light)}
    n.add("ShaderNodeOutputWorld", {"Surface": n.add("ShaderNodeBackground", inputs).outputs[0]})
    n.arrange()
    scene.world = world
