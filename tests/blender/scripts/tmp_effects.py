import sys, json
from pathlib import Path
import bpy
[folder] = sys.argv[sys.argv.index("--") + 1 :]
folder = Path(folder)
[warmup] = [m for n, m in sys.modules.items() if n.endswith("cbt_terrain.run.warmup")]
[panel] = [m for n, m in sys.modules.items() if n.endswith("operators.ui.effects_panel")]
[session] = [m for n, m in sys.modules.items() if n.endswith("operators.scene.session")]
def area():
    w = bpy.context.window_manager.windows[0]
    return w, next(a for a in w.screen.areas if a.type == "VIEW_3D")
def steps():
    yield 2.0
    w, a = area()
    a.spaces.active.show_region_ui = True
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield 1.5
    region = next(r for r in a.regions if r.type == "UI")
    region.active_panel_category = "Terrain"
    while warmup.preparing():
        yield 0.5
    for c in list(bpy.types.Panel.__subclasses__()) + []:
        pass
    mods = sys.modules[panel.__name__.replace("effects_panel","panels")]
    for c in reversed(mods.CLASSES): bpy.utils.unregister_class(c)
    for c in mods.CLASSES:
        if getattr(c,"bl_parent_id",""):
            c.bl_options = set() if c is panel.EffectsPanel else {"DEFAULT_CLOSED"}
        bpy.utils.register_class(c)
    with bpy.context.temp_override(window=w, area=a, region=next(r for r in a.regions if r.type=="WINDOW")):
        bpy.ops.mesh.adaptive_terrain_add()
        bpy.ops.adaptive_terrain.terrain_material()
        bpy.ops.adaptive_terrain.update()
        bpy.ops.adaptive_terrain.show_effect(name="splat_1")
        a.spaces.active.shading.type="SOLID"
    a.tag_redraw()
    region = next(r for r in a.regions if r.type == "UI")
    region.active_panel_category = "Terrain"
    yield 3.0
    a.tag_redraw()
    yield 3.0
    (folder / "ready").touch()
    yield 600
run = steps()
def turn():
    try: return next(run)
    except StopIteration: return None
    except Exception as e:
        (folder/"err").write_text(repr(e)); return None
bpy.app.timers.register(turn, first_interval=1.0)
