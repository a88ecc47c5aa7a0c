# SPDX-License-Identifier: GPL-3.0-or-later
"""What it costs to find out what a scene reads, beside the update of a flight that it precedes."""

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.measure import Row, alternate, stopwatch
from . import engine

UPDATE = "the engine's update of a million triangles in a flight"
MILLION = 1_000_000
LARGE_MATERIAL = 200  # nodes


def demand_rows(rough: HeightField):
    """Of the demo's scene, of a material of 200 nodes, and of either while nothing changes."""
    import bpy

    from ...operators.demand import kept
    from ...operators.demand.demand import demand
    from .in_blender import flight_scene, new_object

    scene = flight_scene()
    obj = new_object("Terrain")
    update = updates(rough)

    def gathered() -> dict[str, float]:
        with stopwatch() as elapsed:
            demand(obj, depsgraph)
        return {"total": elapsed[0]}

    def known() -> dict[str, float]:
        with stopwatch() as elapsed:
            kept.demand_of(obj, depsgraph, "VIEWPORT")
        return {"total": elapsed[0]}

    from ...operators.demo.materials import water_material
    from ...operators.demo.scene import add_sky, sun_direction
    from ...operators.demo.water import add_sea

    add_sky(scene)
    add_sea(scene, rough, water_material(sun_direction()))
    for name, ours, nodes in (
        ("demand", gathered, 20),
        ("demand_large", gathered, LARGE_MATERIAL),
        ("demand_kept", known, LARGE_MATERIAL),
    ):
        obj.data.materials.clear()
        obj.data.materials.append(material(nodes))
        depsgraph = bpy.context.evaluated_depsgraph_get()
        timed = alternate(ours, update)
        yield Row(name, MILLION, timed.ms["total"], UPDATE, timed.baseline_ms, figures={"nodes": nodes})


def material(nodes: int):
    """A material of so many nodes, of which every other reads an attribute of its own."""
    import bpy

    from ...operators.demand.trees import tree_of_new

    made = bpy.data.materials.new(f"{nodes} nodes")
    tree, last = tree_of_new(made), None
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
    return made


def updates(rough: HeightField):
    """Returns what makes the next update of a flight and says how many milliseconds it took."""
    terrain, frame = Terrain(rough), 0
    px = engine.error_px(rough, MILLION, 0)
    terrain.update(scenes.errors(px), [scenes.over(0)])

    def update() -> float:
        nonlocal frame
        frame += 1
        with stopwatch() as elapsed:
            terrain.update(scenes.errors(px), [scenes.over(frame)])
        return elapsed[0]

    return update
