# SPDX-License-Identifier: GPL-3.0-or-later
"""A click that unlinks a node: the next update skips its effect. Run with --enable-event-simulate in a window.

Argument: a folder for the result. The window is a Shader Editor; the terrain follows its settings by itself.
"""

import bpy
from bl_ext.user_default.adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from bl_ext.user_default.adaptive_terrain.operators.session import session
from window_steps import picture, take_steps, terrain, until

result = {"version": bpy.app.version_string}


def made():
    return [name for name in ATTRIBUTES if name in terrain().data.attributes]


def note(moment):
    record = session.record_of(terrain())
    said = {name: [status.readers, status.skipped] for name, status in record.status.effects.items()}
    result[moment] = {"made": made(), "triangles": len(terrain().data.polygons), "said": said}
    result[moment]["runs"] = dict(record.effects_runs)


def editor():
    """Return the node editor's area and the region with the nodes."""
    [area] = [item for item in bpy.context.window_manager.windows[0].screen.areas if item.type == "NODE_EDITOR"]
    return area, next(region for region in area.regions if region.type == "WINDOW")


def wear(obj):
    """Give the terrain a material that reads the slope through a long link."""
    material = bpy.data.materials.new("Rock")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    read, height = (tree.nodes.new("ShaderNodeAttribute") for _ in range(2))
    read.attribute_name, height.attribute_name = "slope", "height"
    shader, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    read.location, height.location, shader.location, output.location = (-900, 0), (-900, -3000), (600, 0), (850, 0)
    tree.links.new(read.outputs["Color"], shader.inputs["Color"])
    tree.links.new(height.outputs["Fac"], shader.inputs["Strength"])
    tree.links.new(shader.outputs[0], output.inputs[0])
    obj.data.materials.append(material)
    return tree


def cut(x, top, bottom):
    """Cut links by Control, the right button and a stroke from top to bottom."""
    window = bpy.context.window_manager.windows[0]
    window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=top)
    yield 0.2
    window.event_simulate(type="LEFT_CTRL", value="PRESS", x=x, y=top, ctrl=True)
    yield 0.2
    window.event_simulate(type="RIGHTMOUSE", value="PRESS", x=x, y=top, ctrl=True)
    yield 0.2
    for step in range(1, 21):
        y = top + (bottom - top) * step // 20
        window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y, ctrl=True)
        yield 0.05
    window.event_simulate(type="RIGHTMOUSE", value="RELEASE", x=x, y=bottom, ctrl=True)
    yield 0.2
    window.event_simulate(type="LEFT_CTRL", value="RELEASE", x=x, y=bottom)
    yield 0.2


def steps():
    yield 2.0
    window = bpy.context.window_manager.windows[0]
    area = next(item for item in window.screen.areas if item.type == "VIEW_3D")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.data.objects["Camera"].location.x += 0.01  # placed by a user: otherwise viewports would decide
    with bpy.context.temp_override(window=window, area=area):
        bpy.ops.mesh.adaptive_terrain_add()
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0)
    note("bare")
    tree = wear(terrain())
    yield from until(lambda: made() == ["height", "slope"])
    yield 1.0
    note("worn")
    area.type, area.ui_type = "NODE_EDITOR", "ShaderNodeTree"
    bpy.context.view_layer.objects.active = terrain()
    area.tag_redraw()
    yield 1.5
    area, region = editor()
    tree.nodes.remove(tree.nodes["Attribute.001"])  # by a script: the viewport follows that, too
    yield from until(lambda: made() == ["slope"])
    yield 1.0
    note("removed")
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.node.view_all()
    yield 1.5
    # Between the nodes there is the link alone: the view shows them all, so it passes the middle.
    x = region.x + region.width // 2
    yield from picture("linked")
    yield from cut(x, region.y + region.height - 60, region.y + 60)
    result["links"] = len(tree.links)
    yield from until(lambda: made() == [])
    yield 1.0
    note("cut")
    yield from picture("unlinked")


take_steps(steps(), result)
