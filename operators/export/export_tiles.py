# SPDX-License-Identifier: GPL-3.0-or-later
"""Export the land for other programs: its heights as one raster or in tiles, or as 3D Tiles."""

from pathlib import Path

import bpy

from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.attributes.splat import NAMES as SPLATS
from ...cbt_terrain.exporting.tile_grid import MAX_TILE, PATTERN, UNREAL_SIZES
from ...cbt_terrain.exporting.tileset import TRIANGLES, export_tileset
from ...cbt_terrain.height_operators.export import FORMATS, WRITERS, check_export, export_raster
from ...cbt_terrain.run import stopping
from .. import jobs
from ..attributes.request import gather_effects
from ..bridge.evaluated import raster_placement_of
from ..bridge.scene_paths import propose_file
from ..job_operator import FileJobOperator
from ..land.bake_land import shaped_field
from ..land.shape_land import check_is_shaped
from ..session import session
from ..session.polls import remember_object
from ..terrain.request import RENDER
from ..text.gap_note import gap_note
from ..text.tile_lines import height_tiles_line, tileset_line
from .export_terrain import draw_formats
from .exporting import check_target

GLOB = ";".join(f"*{suffix}" for suffix in FORMATS)
FREE, WHOLE = "FREE", "WHOLE"
SIZES = (
    *((str(size), f"{size:,}", "Size of a landscape in Unreal Engine") for size in UNREAL_SIZES),
    (FREE, "Other", "Enter another number"),
    (WHOLE, "Whole Raster", "One tile with all heights of the height map"),
)


def mask_requests(obj, depsgraph, field) -> tuple:
    """Return requests for the attributes that tiles get as masks; () for none.

    These are the store's own layers, such as by-products of land effects, and the splats: the weights of the terrain's
    material layers, four in an attribute.
    """
    num_splats = -(-len(obj.adaptive_terrain.layers) // 4)
    names = [*(name for name in ATTRIBUTES if name in field.layers), *SPLATS[:num_splats]]
    evaluated = obj.evaluated_get(depsgraph)
    return (
        gather_effects(obj, evaluated, raster_placement_of(evaluated), depsgraph, RENDER, names).requests
        if names
        else ()
    )


def step_property():
    """Return the property for the distance between exported heights."""
    return bpy.props.FloatProperty(
        name="Sample Step",
        description="Distance between exported heights; 0 for that of the height map, also where finer files are",
        default=0.0,
        min=0.0,
        unit="LENGTH",
        precision=3,
    )


class LandExport(FileJobOperator):
    """Base of operators that write a terrain's shaped land to files while the window stays usable.

    A subclass has `prepare(obj, depsgraph, field)`, which returns the modules of kernels that the export needs and a
    function that writes on any thread: it gets a function for the progress, and returns the line to report. The dialog
    proposes the terrain's name and `name_end`.
    """

    kind = jobs.EXPORT
    name_end = ""
    needs_object_mode = True

    def propose(self, context) -> None:
        """Propose a file with the terrain's name.

        Refuse land that is not shaped yet: its shaping has its own job.
        """
        check_is_shaped(context.object, context.evaluated_depsgraph_get())
        remember_object(self, context)
        propose_file(self, context.object, self.name_end)

    def check_file(self) -> None:
        """Raise TerrainError, before any work, if the chosen file cannot be written."""
        check_target(Path(self.filepath))

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Open the shaped land and write on a thread; return the line to report. Raises TerrainError."""
        self.check_file()
        open_land = shaped_field(context.object, context.evaluated_depsgraph_get())

        def open_locked():
            """Return the height field of the shaped land; on the job's thread."""
            with session.engine_lock:
                return open_land()

        field = yield from jobs.run_on_thread(job, open_locked)
        job.raise_if_stopped()  # its terrain may be gone
        modules, write = self.prepare(job.terrain(), bpy.context.evaluated_depsgraph_get(), field)
        yield from jobs.prepare_kernels(job, modules)

        def write_stoppable() -> str:
            """Write until the job is stopped; return the line to report."""
            with stopping.checking(job.raise_if_stopped):
                return write(job.progress) + gap_note(field)

        return (yield from jobs.run_on_thread(job, write_stoppable))

    def finish(self, _context, _obj, line: str) -> None:
        """Report the written files."""
        self.report({"INFO"}, line)


class ExportHeights(LandExport, bpy.types.Operator):
    """Write the heights of the shaped land as a 32-bit GeoTIFF or EXR with its place on Earth, and each by-product as
    another file"""

    bl_idname = "adaptive_terrain.export_heights"
    bl_label = "Export Heights"

    name_end = "_heights"
    filename_ext = ".tif"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in WRITERS), options={"HIDDEN"})
    step: step_property()

    def draw(self, _context):
        """Draw the formats and the distance between heights."""
        draw_formats(self.layout, WRITERS)
        self.layout.use_property_split = True
        self.layout.prop(self, "step")

    def check_file(self) -> None:
        """Raise TerrainError if the file is of no format for heights, or cannot be written."""
        check_export(self.filepath)

    def prepare(self, _obj, _depsgraph, field):
        """Return the kernels of points between samples, and a function that writes heights and layers as rasters.

        Only another distance between heights, or finer files of a mosaic, need the kernels. The rasters are named after
        the chosen file.
        """
        from ...kernels.query import grid

        def write(on_progress) -> str:
            """Write the files, and return their names."""
            files = export_raster(field.path, self.filepath, on_progress=on_progress, step=step)
            return f"Written: {', '.join(file.name for file in files)}"

        step = self.step  # read now: Blender may free the operator while `write` runs on its thread
        return [grid] if step or field.raster.finer else [], write


class ExportHeightTiles(LandExport, bpy.types.Operator):
    """Write the heights of the land as tiles for game engines, its layers as masks, and their scale and position as a
    JSON file"""

    bl_idname = "adaptive_terrain.export_tiles"
    bl_label = "Export Height Tiles"

    filename_ext = ".png"
    check_extension = None  # the suffix that the user types is the format
    filter_glob: bpy.props.StringProperty(default=GLOB, options={"HIDDEN"})
    size: bpy.props.EnumProperty(
        name="Tile Size", description="Number of heights along each side of a tile", items=SIZES, default=WHOLE
    )
    free_size: bpy.props.IntProperty(
        name="Samples", description="Number of heights along each side of a tile", default=513, min=2, max=MAX_TILE
    )
    step: step_property()
    fit: bpy.props.BoolProperty(
        name="Fit Number of Tiles",
        description="Change the distance between heights so that a given number of tiles covers the land exactly",
    )
    tiles: bpy.props.IntVectorProperty(
        name="Tiles", description="Number of tiles along X and Y", size=2, default=(1, 1), min=1
    )
    overlap: bpy.props.IntProperty(
        name="Overlap",
        description="Rows of heights that neighbouring tiles share at their border: 0 or 1, as the game engine expects",
        default=1,
        min=0,
        max=1,
    )
    flip: bpy.props.BoolProperty(
        name="South First",
        description="Begin files and tile numbers in the south instead of the north, for programs that expect it",
    )
    masks: bpy.props.BoolProperty(
        name="Masks",
        description="Also write the layers and the by-products of land effects as 8-bit PNG images",
        default=True,
    )
    pattern: bpy.props.StringProperty(
        name="Pattern",
        description="File name of each tile: {name} is the name that you choose, {x} and {y} are the tile's numbers",
        default=PATTERN,
    )

    def draw(self, _context):
        """Draw the options of the tiles. The fit applies unless the whole land is one tile, the step without a fit."""
        draw_formats(self.layout, FORMATS)
        column = self.layout.column()
        column.use_property_split = True
        column.prop(self, "size")
        if self.size == FREE:
            column.prop(self, "free_size")
        fits = self.fit and self.size != WHOLE
        if self.size != WHOLE:
            row = column.row()
            row.use_property_split = False  # its name needs the whole width
            row.prop(self, "fit")
            if fits:
                column.prop(self, "tiles")
            column.prop(self, "overlap")
        if not fits:
            column.prop(self, "step")
        for name in ("flip", "masks", "pattern"):
            column.prop(self, name)

    def prepare(self, obj, depsgraph, field):
        """Return the kernels of heights and masks, and a function that writes tiles, masks and their JSON.

        They are named after the chosen file, in its folder.
        """
        from ...cbt_terrain.attributes.evaluate import kernels_of
        from ...cbt_terrain.exporting.height_tiles import HeightTiles, export_height_tiles
        from ...kernels.query import grid

        path, sizes = Path(self.filepath), {FREE: self.free_size, WHOLE: 0}  # 0: one tile
        # Either a number of tiles covers the terrain exactly, or samples have a distance in metres (0: the raster's).
        fits = self.fit and self.size != WHOLE
        settings = HeightTiles(
            form=path.suffix[1:].lower(),
            size=sizes[self.size] if self.size in sizes else int(self.size),  # samples of a tile's side
            tiles=tuple(self.tiles) if fits else None,  # numbers east and south
            step=0.0 if fits else self.step,
            overlap=self.overlap,
            is_flipped=self.flip,
            name=path.stem,
            pattern=self.pattern,
        )
        masks = mask_requests(obj, depsgraph, field) if self.masks else ()

        def write(on_progress) -> str:
            """Write the tiles; return the line to report."""
            index = export_height_tiles(field, path.parent, settings, masks, on_progress)
            return height_tiles_line(settings.name, index)

        return [grid, *kernels_of(plan(masks))], write


class ExportTileset(LandExport, bpy.types.Operator):
    """Write the land as 3D Tiles for viewers of globes and maps: glb files in levels of detail, each with the largest
    error that it has"""

    bl_idname = "adaptive_terrain.export_tileset"
    bl_label = "Export 3D Tiles"

    name_end = "_tileset"  # height tiles have NAME.json
    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})
    error_m: bpy.props.FloatProperty(
        name="Finest Error",
        description="How far the finest level may be above or below the ground. Smaller is finer and makes more files",
        default=1.0,
        min=1e-4,
        unit="LENGTH",
    )
    triangles: bpy.props.IntProperty(
        name="Triangles",
        description="Average number of triangles in a file of the finest level. Fewer make more and smaller files",
        default=TRIANGLES,
        min=1,
    )

    def prepare(self, _obj, _depsgraph, field):
        """Return no kernels, and a function that writes the 3D Tiles: the chosen file, and tiles in its folder."""
        path, options = Path(self.filepath), (self.error_m, self.triangles)
        return [], lambda on_progress: tileset_line(path.name, export_tileset(field, path, *options, on_progress))
