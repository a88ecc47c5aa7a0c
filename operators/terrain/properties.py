# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings: of a terrain on its object (`object.adaptive_terrain`), of all on the scene (`scene.adaptive_terrain`)."""

import math
from contextlib import suppress
from pathlib import Path

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.heightfield import INTERPOLATIONS
from ...cbt_terrain.field.island import DEFAULT_SEED
from ...cbt_terrain.field.lands import LANDS, BuiltInTerrain
from ...cbt_terrain.rasters.raster import RAW_TYPES
from ..attributes import properties as effect_properties
from ..bridge.scene_paths import absolute_path
from ..land import properties as land_properties
from ..layers.properties import LayerSettings
from ..maps.properties import PATH_OPTIONS, MapSettings
from .detail_properties import RenderDetail, ViewportDetail, changed
from .displacement_properties import DisplacementSettings

ISLAND, FILE = "ISLAND", "FILE"
NO_OVERLAY, ERROR_OVERLAY, LEVEL_OVERLAY = "NONE", "ERROR", "LEVEL"
SCENE_CAMERA, CHOSEN_CAMERA, VIEWPORT_VIEW = "SCENE", "CHOSEN", "VIEW"


def land_items() -> list[tuple]:
    """Return the enum items of the built-in lands. A .blend file stores their numbers; 1 is FILE as a source."""
    numbers = (number for number in range(len(LANDS) + 1) if number != 1)
    return [(name.upper(), land.label, land.about, "NONE", next(numbers)) for name, land in LANDS.items()]


def built_in_land(settings) -> BuiltInTerrain | None:
    """Return the built-in land that the settings choose as source; None for a file."""
    return LANDS.get(settings.source.lower())


def _on_source(self, _context) -> None:
    """Reset the size and the height scale if the Add menu set them for the land that was chosen before.

    The Add menu scales a land's heights like its width, so its height scale is recognised by that ratio.
    """
    ratios = [self.extent[0] / land.side for land in LANDS.values()]
    if not self.use_extent or not any(math.isclose(self.height_scale, ratio, rel_tol=1e-5) for ratio in ratios):
        return
    if (land := built_in_land(self)) is not None:
        self.height_scale = self.extent[0] / land.side
    else:
        self.use_extent = False
        self.property_unset("height_scale")


def _on_set_heights(self, _context) -> None:
    """Begin with the heights that the store has, unless the user has entered some."""
    if self.use_heights and self.store and not any(map(self.is_property_set, ("lowest", "highest"))):
        with suppress(TerrainError):  # the update reports it
            store = stores.read_json(Path(absolute_path(self.store)))
            self.lowest, self.highest = store["min_height"], store["max_height"]


def _on_overlay(self, context) -> None:
    """Switch viewports from attribute colours back to materials when the last overlay of the file is off."""
    changed(self, context)
    if any(obj.adaptive_terrain.overlay != NO_OVERLAY for obj in bpy.data.objects):
        return
    for area in (area for window in bpy.context.window_manager.windows for area in window.screen.areas):
        if area.type == "VIEW_3D" and area.spaces.active.shading.color_type == "VERTEX":
            area.spaces.active.shading.color_type = "MATERIAL"


class CleanupSettings(bpy.types.PropertyGroup):
    """Parts that are cut away from the finished mesh."""

    use_below: BoolProperty(name="Delete Below", description="Cut away everything below a height", update=changed)
    below: FloatProperty(
        name="Height", description="Height in metres below which the ground is cut away", unit="LENGTH", update=changed
    )
    boundary: PointerProperty(
        name="Boundary",
        description="Cut the terrain along the outline of this object, seen from above",
        type=bpy.types.Object, poll=lambda self, item: item.type == "MESH" and item != self.id_data, update=changed,
    )  # fmt: skip


class SourceFile(bpy.types.PropertyGroup):
    """One of several files that form a terrain."""

    path: StringProperty(
        name="File", description="Height map, or folder of height maps, that forms one terrain with those above it",
        subtype="FILE_PATH", options=PATH_OPTIONS,
    )  # fmt: skip


class TerrainSettings(bpy.types.PropertyGroup):
    """Everything that a terrain is made from."""

    enabled: BoolProperty(name="Adaptive Terrain", description="This object's mesh is written by Adaptive Terrain")
    store: StringProperty(
        name="Store",
        description="Folder of the imported heights. Import sets it; change it only if you have moved the folder",
        subtype="DIR_PATH", options=PATH_OPTIONS, update=changed,
    )  # fmt: skip

    anchor: FloatVectorProperty(
        name="Anchor",
        description="Point of the terrain that is the origin of its object, in metres east and north of the middle of "
        "the height map. Move World Here sets it",
        size=2, default=(0.0, 0.0), unit="LENGTH", options={"HIDDEN"}, update=changed,
    )  # fmt: skip
    source: EnumProperty(
        name="Source", description="Where the heights come from",
        items=[*land_items(),
               (FILE, "File", "A height map: GeoTIFF, VRT, ASCII grid, HGT, PNG, EXR, RAW, NPY", "NONE", 1)],
        update=_on_source,
    )  # fmt: skip
    source_path: StringProperty(
        name="File", description="Height map to import", subtype="FILE_PATH", options=PATH_OPTIONS
    )
    more_sources: CollectionProperty(type=SourceFile)
    priority: EnumProperty(
        name="Overlaps",
        description="Which file is used where several overlap",
        items=[("order", "Last File", "The last file in the list"),
               ("resolution", "Finest File", "The file with the smallest step"),
               ("newest", "Newest File", "The file that was changed last")],
    )  # fmt: skip
    blend: BoolProperty(
        name="Blend Borders",
        description="Blend the heights of a finer file to those of a coarser one below it, in a ring inside its border",
        default=True,
    )
    sample_step: FloatProperty(
        name="Sample Step",
        description="Metres between samples of a terrain of several files; 0 for the step of the finest file",
        min=0.0, unit="LENGTH",
    )  # fmt: skip
    raw_size: IntVectorProperty(
        name="Samples", description="Width and height of the RAW file, in values", size=2, default=(0, 0), min=0
    )
    raw_dtype: EnumProperty(
        name="Type", description="Type of the values in the RAW file",
        items=[(name, name, f"The values in the RAW file are {name}") for name in RAW_TYPES],
        default="uint16",
    )  # fmt: skip
    raw_little_endian: BoolProperty(
        name="Little Endian",
        description="Byte order of the RAW file. Change it if the land looks like noise",
        default=True,
    )
    band: IntProperty(
        name="Band", description="Band of the file that holds the heights; the first is 1", default=1, min=1
    )
    channel: StringProperty(
        name="Channel", description="EXR channel that holds the heights; empty for the first that looks like a height"
    )
    encoding: EnumProperty(
        name="Encoding",
        description="How the colours of an image hold heights, as in web map tiles",
        items=[
            ("AUTO", "Automatic", "Recognise heights in web map tiles whose path ends with z/x/y.png"),
            ("terrarium", "Terrarium", "Steps of 1/256 m above -32,768 m"),
            ("mapbox", "Mapbox", "Terrain-RGB: steps of 0.1 m above -10,000 m"),
            ("plain", "None", "The image holds no coded heights"),
        ],
    )
    cell: FloatProperty(
        name="Cell Size",
        description="Side of the cells of gridded points; 0 takes four points a cell in the mean",
        min=0.0, unit="LENGTH",
    )  # fmt: skip
    first_row_south: BoolProperty(
        name="First Row South", description="Turn the map over, if the first row of the file is the southern one"
    )
    project: StringProperty(
        name="Reproject",
        description="Convert the map to another coordinate system: utm for true shapes in metres, or a code such as "
        "EPSG:25832. Empty keeps its own",
    )  # fmt: skip
    use_extent: BoolProperty(name="Set Size", description="Enter the real-world size instead of using the file's")
    extent: FloatVectorProperty(
        name="Size",
        description="Size in metres from west to east and from south to north",
        size=2, default=(1000.0, 1000.0), min=0.001, unit="LENGTH",
    )  # fmt: skip
    height_scale: FloatProperty(
        name="Metres per Unit",
        description="Metres in one unit of the file's values, such as 0.3048 for feet. Press Import after a change",
        default=1.0, precision=4,
    )  # fmt: skip
    height_offset: FloatProperty(
        name="Metres at Zero",
        description="Height of the file's value 0, in metres. Press Import after a change",
        unit="LENGTH", default=0.0,
    )  # fmt: skip
    use_heights: BoolProperty(
        name="Set Heights",
        description="Enter the heights of the lowest and the highest value. Otherwise an 8 or 16-bit image without a "
        "size in metres gets a relief of a quarter of its width",
        update=_on_set_heights,
    )
    lowest: FloatProperty(name="Lowest", description="Height of the lowest value in the file, in metres", unit="LENGTH")
    highest: FloatProperty(
        name="Highest", description="Height of the highest value in the file, in metres", default=1000.0, unit="LENGTH"
    )
    use_no_data: BoolProperty(
        name="Set No-Data", description="Enter the value that marks missing heights, instead of using the file's"
    )
    no_data: FloatProperty(name="No-Data", description="Value that marks missing heights", default=-9999.0)
    holes: BoolProperty(
        name="Cut Out No-Data", description="Leave holes where heights are missing instead of filling them"
    )
    island_size: IntProperty(
        name="Samples",
        description="Heights along each side of the built-in land: more is finer and takes longer",
        default=1025,
        min=3,
        max=16385,
    )
    seed: IntProperty(
        name="Seed", description="Another number makes other land of the same kind", default=DEFAULT_SEED, min=0
    )

    camera_source: EnumProperty(
        name="Seen From", description="View that decides where the terrain is fine",
        items=[(SCENE_CAMERA, "Scene Camera", "Fine where the scene's camera looks. Until one is placed above the "
                                              "ground, fine where the viewports look"),
               (CHOSEN_CAMERA, "Chosen Camera", "Fine where one chosen camera looks, whichever camera renders"),
               (VIEWPORT_VIEW, "Viewport", "Fine where the 3D viewports look; a render uses the scene's camera")],
        update=changed,
    )  # fmt: skip
    camera: PointerProperty(
        name="Camera",
        description="Camera that decides where the terrain is fine",
        type=bpy.types.Object,
        poll=lambda self, item: item.type == "CAMERA",
        update=changed,
    )
    interpolation: EnumProperty(
        name="Interpolation",
        description="Shape of the ground between the heights of the file",
        items=[(INTERPOLATIONS[0], "Bilinear", "Straight from height to height: never above or below them"),
               (INTERPOLATIONS[1], "Bicubic", "Smooth, without facets close to the camera, for more triangles; "
                "beside cliffs it may overshoot")],
        update=changed,
    )  # fmt: skip
    vertical_scale: FloatProperty(
        name="Vertical Scale",
        description="Factor on all heights: more than 1 exaggerates them. It needs no new import",
        default=1.0,
        update=changed,
    )
    vertical_offset: FloatProperty(
        name="Vertical Offset",
        description="Raise or lower the whole terrain, in metres. It needs no new import",
        unit="LENGTH", update=changed,
    )  # fmt: skip
    ground: PointerProperty(type=DisplacementSettings)
    viewport: PointerProperty(type=ViewportDetail)
    render: PointerProperty(type=RenderDetail)
    live: BoolProperty(
        name="Live Update",
        description="Keep the mesh up to date while the camera moves, and shape finer land while nothing changes, "
        "without blocking Blender. It pauses in Edit Mode",
        default=True, update=changed,
    )  # fmt: skip
    frozen: StringProperty(
        name="Frozen Detail",
        description="The triangles that the mesh keeps whatever its camera sees; empty: it follows its camera",
        options={"HIDDEN"}, update=changed,
    )  # fmt: skip
    smooth: BoolProperty(
        name="Smooth Shading",
        description="Shade the ground smoothly; otherwise each face is flat",
        default=True, update=changed,
    )  # fmt: skip
    overlay: EnumProperty(
        name="Overlay", description="Colours that show how the mesh is made",
        items=[(NO_OVERLAY, "None", "No colours"),
               (ERROR_OVERLAY, "Screen Error", "Colour each triangle by its largest error in pixels; updates take "
                                               "longer"),
               (LEVEL_OVERLAY, "Level", "Colour each triangle by how often it was halved: high levels are fine")],
        update=_on_overlay,
    )  # fmt: skip
    effects: PointerProperty(type=effect_properties.EffectsSettings)
    cleanup: PointerProperty(type=CleanupSettings)
    maps: PointerProperty(type=MapSettings)
    layers: CollectionProperty(type=LayerSettings)
    active_layer: IntProperty(name="Active Layer", options=set())
    land: PointerProperty(type=land_properties.LandSettings)
    bake_error_m: FloatProperty(
        name="Bake Error",
        description="How far a baked mesh may be above or below the ground, in metres",
        default=1.0, min=1e-6, soft_max=100.0, precision=3, unit="LENGTH",
    )  # fmt: skip
    bake_fit: BoolProperty(
        name="Fit",
        description="Use fewer triangles for the same error, by moving vertices off the ground. Baking takes longer",
        default=False,
    )  # fmt: skip
    collider_error_m: FloatProperty(
        name="Collider Error",
        description="How far the collider may be above or below the ground, in metres",
        default=1.0, min=1e-6, soft_max=100.0, precision=3, unit="LENGTH",
    )  # fmt: skip
    reports: StringProperty(
        name="Reports",
        description="Folder of accuracy reports; each terrain has a subfolder with its name",
        default="//accuracy/", subtype="DIR_PATH", options=PATH_OPTIONS,
    )  # fmt: skip


class SceneSettings(bpy.types.PropertyGroup):
    """Settings of all terrains of a scene."""

    stop_stale_renders: BoolProperty(
        name="Stop Renders That Would Be Stale",
        description="End a background render if a terrain cannot be updated for a frame, instead of rendering the mesh "
        "of another frame",
        default=True,
    )  # fmt: skip
