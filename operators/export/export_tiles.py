# SPDX-License-Identifier: GPL-3.0-or-later
"""Export the land in tiles for other programs."""

from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.splat import NAMES as SPLATS
from ...cbt_terrain.exporting.height_tiles import PATTERN, HeightTiles, export_height_tiles
from ...cbt_terrain.exporting.tile_grid import MAX_TILE, UNREAL_SIZES
from ...cbt_terrain.exporting.tileset import TRIANGLES, export_tileset
from ...cbt_terrain.height_operators.export import FORMATS
from ..attributes.request import gather_effects
from ..land.bake_land import LandOperator, shaped_field
from ..session import session
from ..terrain.request import RENDER
from ..text.tile_lines import height_tiles_line, tileset_line
from .exporting import check_target

GLOB = ";".join(f"*{suffix}" for suffix in FORMATS)
FREE, WHOLE = "FREE", "WHOLE"
SIZES = (
    *((str(size), f"{size:,}", "Size of an Unreal landscape") for size in UNREAL_SIZES),
    (FREE, "Other", "Any number of samples"),
    (WHOLE, "Whole Raster", "One tile with the samples of the height map"),
)


def mask_requests(obj, depsgraph, field) -> tuple:
    """Return requests for the by-products that a terrain's store has, and for its splat layers."""
    num_splats = -(-len(obj.adaptive_terrain.layers) // 4)
    names = [*(name for name in ATTRIBUTES if name in field.layers), *SPLATS[:num_splats]]
    evaluated = obj.evaluated_get(depsgraph)
    return gather_effects(obj, evaluated, obj.matrix_world, depsgraph, RENDER, names).requests if names else ()


class ExportHeightTiles(LandOperator, bpy.types.Operator, ExportHelper):
    """Write the heights of the land as tiles for game engines, its by-products and layers as 8-bit masks, and their
    scale and position as JSON"""

    bl_idname = "adaptive_terrain.export_tiles"
    bl_label = "Export Height Tiles"

    filename_ext = ".png"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=GLOB, options={"HIDDEN"})
    size: bpy.props.EnumProperty(
        name="Tile Size", description="Samples along a tile's side", items=SIZES, default=WHOLE
    )
    free_size: bpy.props.IntProperty(name="Samples", description="Samples a side", default=513, min=2, max=MAX_TILE)
    fit: bpy.props.BoolProperty(
        name="Fit Number of Tiles", description="Space the samples so that this number of tiles covers the land exactly"
    )
    tiles: bpy.props.IntVectorProperty(name="Tiles", description="Tiles along X and Y", size=2, default=(1, 1), min=1)
    overlap: bpy.props.IntProperty(
        name="Overlap", description="Samples that neighbouring tiles share", default=1, min=0, max=1
    )
    flip: bpy.props.BoolProperty(
        name="South First", description="The first row of samples and tiles is the southern one"
    )
    masks: bpy.props.BoolProperty(
        name="Masks", description="Also write by-products and splat layers as 8-bit PNG", default=True
    )
    pattern: bpy.props.StringProperty(
        name="Pattern", description="Name of a tile, with {name}, {x} and {y}", default=PATTERN
    )

    def draw(self, _context):
        column = self.layout.column()
        column.use_property_split = True
        column.prop(self, "size")
        if self.size == FREE:
            column.prop(self, "free_size")
        if self.size != WHOLE:
            column.prop(self, "fit")
            if self.fit:
                column.prop(self, "tiles")
            column.prop(self, "overlap")
        for name in ("flip", "masks", "pattern"):
            column.prop(self, name)

    def _carry_out(self, obj, depsgraph):
        path, sizes = Path(self.filepath), {FREE: self.free_size, WHOLE: 0}
        settings = HeightTiles(
            form=path.suffix[1:].lower(),
            size=sizes[self.size] if self.size in sizes else int(self.size),
            tiles=tuple(self.tiles) if self.fit and self.size != WHOLE else None,
            overlap=self.overlap,
            is_flipped=self.flip,
            name=path.stem,
            pattern=self.pattern,
        )
        field = shaped_field(obj, depsgraph)
        masks = mask_requests(obj, depsgraph, field) if self.masks else ()
        with session.engine_lock:
            index = export_height_tiles(field, path.parent, settings, masks)
        self.report({"INFO"}, height_tiles_line(settings.name, index))
        return {"FINISHED"}


class ExportTileset(LandOperator, bpy.types.Operator, ExportHelper):
    """Write the land as 3D Tiles: glb files with levels of detail, whose geometric error is a bound that holds"""

    bl_idname = "adaptive_terrain.export_tileset"
    bl_label = "Export 3D Tiles"

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})
    error_m: bpy.props.FloatProperty(
        name="Finest Error",
        description="Largest vertical error of the finest level",
        default=1.0,
        min=1e-4,
        unit="LENGTH",
    )
    triangles: bpy.props.IntProperty(
        name="Triangles", description="Mean number in a tile of the finest level", default=TRIANGLES, min=1
    )

    def _carry_out(self, obj, depsgraph):
        path = Path(self.filepath)
        check_target(path)
        field = shaped_field(obj, depsgraph)
        with session.engine_lock:
            report = export_tileset(field, path, self.error_m, self.triangles)
        self.report({"INFO"}, tileset_line(path.name, report))
        return {"FINISHED"}
