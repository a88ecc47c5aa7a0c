# SPDX-License-Identifier: GPL-3.0-or-later
"""Time to find the attributes that a scene reads, so that unused effects are not computed."""

from ...cbt_terrain.field.heightfield import HeightField
from ..rig import scenes
from ..rig.measure import BenchmarkRow, alternate, time_ms
from ..rig.scenes import MILLION
from . import engine

NODES = 20


def demand_row(rough: HeightField) -> BenchmarkRow:
    """Measure the search through the demo's sky, its sea and one material, against the update of a flight."""
    import bpy

    from ...operators.bridge.demand.demand import find_demand
    from ...operators.demo.materials import water_material
    from ...operators.demo.scene import add_sky, sun_direction
    from ...operators.demo.water import add_sea
    from .in_blender import flight_scene, new_object

    scene = flight_scene()
    obj = new_object("Terrain")
    add_sky(scene)
    add_sea(scene, rough, water_material(sun_direction()))
    obj.data.materials.append(material(NODES))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    flight = scenes.TimedFlight(rough, scenes.over, scenes.errors(engine.error_px(rough, MILLION)))
    timed = alternate(lambda: {"total": time_ms(lambda: find_demand(obj, depsgraph))}, lambda: flight()["total"])
    baseline = "the engine's update of a flight"
    return BenchmarkRow("demand", MILLION, timed.ms["total"], baseline, timed.baseline_ms, figures={"nodes": NODES})


def material(nodes: int):
    """Return a material of `nodes` nodes, half of which read an attribute each."""
    import bpy

    from ...operators.bridge.demand.trees import tree_of_new

    result = bpy.data.materials.new(f"{nodes} nodes")
    tree, last = tree_of_new(result), None
    tree.nodes.clear()
    for number in range(nodes // 2 - 1):
        read, mix = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeMix")
        read.attribute_name, mix.data_type = f"attribute {number}", "RGBA"
        tree.links.new(read.outputs["Color"], mix.inputs[7])
        if last is not None:
            tree.links.new(last, mix.inputs[6])
        last = mix.outputs[2]
    shader, output = (tree.nodes.new("ShaderNode" + kind) for kind in ("Emission", "OutputMaterial"))
    tree.links.new(last, shader.inputs[0])
    tree.links.new(shader.outputs[0], output.inputs[0])
    return result
