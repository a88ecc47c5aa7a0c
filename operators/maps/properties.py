# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the maps that are baked of a terrain (`object.adaptive_terrain.maps`)."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.coding import EXR, PNG
from ...cbt_terrain.run.owned_files import MAPS
from ..bridge.scene_paths import absolute_path

FRAME, SHOT, WHOLE = "FRAME", "SHOT", "WHOLE"
READ, CHOSEN = "READ", "CHOSEN"
# Paths may begin with "//", the .blend file's folder; from Blender 4.5 on a property has to declare it.
PATH_OPTIONS = {"ANIMATABLE"} | ({"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set())


def map_folder(obj) -> Path:
    """Return the folder of a terrain's maps: `maps.folder`/`maps.mark`, or <store>_maps/`maps.mark` if none is set.

    maps.mark: name of the terrain's own folder, empty before the first baking.
    """
    settings = obj.adaptive_terrain
    store = Path(absolute_path(settings.store))
    chosen = settings.maps.folder
    parent = Path(absolute_path(chosen)) if chosen else store.with_name(store.name + MAPS)
    return parent / bpy.path.clean_name(settings.maps.mark)


def title_of(name: str) -> str:
    """Return the name of an attribute as a title, as panels show it."""
    return name.replace("_", " ").title()


class MapSettings(bpy.types.PropertyGroup):
    """Which maps are baked, how fine, and where they are kept."""

    frames: EnumProperty(
        name="For",
        description="Views for which the images are fine enough",
        items=[
            (FRAME, "Frame", "The render's camera at its place in this frame, in every direction"),
            (SHOT, "Shot", "All frames of the scene; ground that is in none of them gets the coarsest images"),
            (WHOLE, "Whole", "Everywhere as fine as the height map"),
        ],
    )
    which: EnumProperty(
        name="Maps",
        description="Which attributes are baked",
        items=[
            (READ, "Read", "The attributes that the materials show as images"),
            (CHOSEN, "Chosen", "The attributes that are chosen below"),
        ],
        default=CHOSEN,
    )
    chosen: EnumProperty(
        name="Chosen",
        description="Attributes to bake",
        options={"ENUM_FLAG"},
        items=[(name, title_of(name), ATTRIBUTES[name].about) for name in sorted(ATTRIBUTES)],
        default={"detail_normal"} & set(ATTRIBUTES),
    )
    use_budget: BoolProperty(name="Limit Memory", description="Make all maps coarser until they fit into the memory")
    budget_mb: FloatProperty(
        name="Memory",
        description="Memory of the images in Blender, in megabytes",
        default=500.0,
        min=1.0,
        soft_max=16000.0,
    )
    form: EnumProperty(
        name="Format",
        description="File format of the images",
        items=[
            (PNG, "PNG", "Small files: 8 bits for directions and shares, 16 bits for measures"),
            (EXR, "OpenEXR", "Exact floating-point values, for four times the memory"),
        ],
    )
    folder: StringProperty(
        name="Folder",
        description="Folder of the images, with a subfolder for each terrain; empty: beside the store",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
    )
    mark: StringProperty(
        name="Mark", description="Name of this terrain's folder, unlike those of others", options={"HIDDEN"}
    )
