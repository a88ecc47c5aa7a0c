# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs that write a store in tiles for other programs."""

import argparse
from pathlib import Path

from ..text.console import Progress, print_line
from .argument_types import (
    MAX_ERROR_M,
    MAX_INT,
    argparse_type,
    count,
    count_from_one,
    pair,
    parse_effects,
    path,
    positive,
)


def add_tiles(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `tiles`."""
    from ...cbt_terrain.exporting.tile_grid import PATTERN, UNREAL_SIZES
    from ...cbt_terrain.height_operators.export import FORMATS

    forms = [suffix[1:] for suffix in FORMATS]
    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    verb.add_argument("--out", type=path, required=True, metavar="DIR", help="folder for the tiles and NAME.json")
    verb.add_argument("--format", choices=forms, default="png", help="png and r16: 16 bits; others: float32 (png)")
    sizes = f"samples of a tile's side; Unreal: {', '.join(map(str, UNREAL_SIZES))} (one tile, as the raster)"
    verb.add_argument("--size", type=count, default=0, metavar="N", help=sizes)
    step = "metres between samples, those of finer files included (the raster's step)"
    verb.add_argument("--step", type=positive(MAX_ERROR_M), default=0.0, metavar="METRES", help=step)
    fitted = "tiles east and south that cover the terrain exactly, instead of a step"
    verb.add_argument("--tiles", type=pair("x", int, MAX_INT), metavar="NxM", help=fitted)
    verb.add_argument("--overlap", type=int, choices=(0, 1), default=1, help="samples that neighbours share (1)")
    verb.add_argument("--flip", action="store_true", help="the first row of samples and tiles is the southern one")
    verb.add_argument("--name", default="terrain", help="of the tiles and the JSON file (terrain)")
    verb.add_argument("--pattern", default=PATTERN, help=f"name of a tile ({PATTERN})")
    masks = "attributes to write as 8-bit PNG: those that the store has as layers (auto), none, or these"
    verb.add_argument("--masks", type=argparse_type(parse_effects), metavar="auto|none|F,F", help=masks)


def run_tiles(arguments) -> None:
    """Run the verb `tiles`: write height tiles and masks, and print a summary."""
    from ...cbt_terrain.attributes.attribute import AttributeRequest
    from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
    from ...cbt_terrain.exporting.height_tiles import HeightTiles, export_height_tiles
    from ...cbt_terrain.field.store import open_store
    from ..export.exporting import make_folder
    from ..text.gap_note import gap_note
    from ..text.tile_lines import height_tiles_line

    field = open_store(arguments.store)
    make_folder(arguments.out)
    names = arguments.masks
    if names is None:  # auto
        names = tuple(name for name in ATTRIBUTES if name in field.layers)
    settings = HeightTiles(
        form=arguments.format,
        size=arguments.size,
        step=arguments.step,
        tiles=arguments.tiles,
        overlap=arguments.overlap,
        is_flipped=arguments.flip,
        name=arguments.name,
        pattern=arguments.pattern,
    )
    masks = [AttributeRequest(name, readers=("this command",)) for name in names]
    with Progress(1.0, "tiles", arguments.progress) as bar:
        index = export_height_tiles(field, arguments.out, settings, masks, bar.to)
    print_line(height_tiles_line(str(Path(arguments.out) / settings.name), index) + gap_note(field))


def add_tileset(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `tileset`."""
    from ...cbt_terrain.exporting.tileset import TRIANGLES

    verb.add_argument("--store", type=path, required=True, metavar="DIR")
    error = "largest vertical error of the finest level"
    verb.add_argument("--max-error", type=positive(MAX_ERROR_M), required=True, metavar="METRES", help=error)
    verb.add_argument("--out", type=path, required=True, metavar="FILE.json", help="tiles are written beside it")
    triangles = f"mean number in a tile of the finest level ({TRIANGLES:,})"
    verb.add_argument("--triangles", type=count_from_one, default=TRIANGLES, metavar="N", help=triangles)


def run_tileset(arguments) -> None:
    """Run the verb `tileset`: write 3D Tiles, and print a summary."""
    from ...cbt_terrain.exporting.tileset import export_tileset
    from ...cbt_terrain.field.store import open_store
    from ..export.exporting import check_target
    from ..text.gap_note import gap_note
    from ..text.tile_lines import tileset_line

    check_target(arguments.out)
    field = open_store(arguments.store)
    with Progress(1.0, "tileset", arguments.progress) as bar:
        report = export_tileset(field, arguments.out, arguments.max_error, arguments.triangles, bar.to)
    print_line(tileset_line(str(arguments.out), report) + gap_note(field))


def add_map(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `map`."""
    verb.add_argument("--scene", type=path, required=True, metavar="X.blend")
    verb.add_argument("--out", type=path, required=True, metavar="FILE", help=".png, .jpg or .tif")
    verb.add_argument("--terrain", metavar="NAME", help="the object (the first terrain of the scene)")
    size = verb.add_mutually_exclusive_group()
    size.add_argument("--pixels", type=count_from_one, default=1, metavar="N", help="along each side of a cell (1)")
    size.add_argument("--metres", type=positive(MAX_ERROR_M), metavar="M", help="side of a pixel")
    verb.add_argument("--tiles", type=pair("x", int, MAX_INT), default=(1, 1), metavar="NxM", help="across and down")
    verb.add_argument("--no-geotiff", dest="geotiff", action="store_false", help="write world files alone")


def run_map(arguments) -> None:
    """Run the verb `map`: render the terrain from above and print the files."""
    from ...cbt_terrain.errors import TerrainError
    from ..blender import need_bpy

    bpy = need_bpy("A .blend file")
    from ..export.blend_files import open_scene
    from ..export.map_camera import add_map_camera
    from ..export.render_map import render_map

    scene, objects = open_scene(arguments.scene)
    matching = [obj for obj in objects if arguments.terrain in (None, obj.name)]
    if not matching:
        names = ", ".join(obj.name for obj in objects)
        raise TerrainError(f"The scene has no terrain {arguments.terrain!r}", expected=f"one of {names}")
    matching[0].adaptive_terrain.camera_source = "SCENE"  # it is refined for the map's camera, not for a chosen one
    add_map_camera(matching[0], bpy.context.evaluated_depsgraph_get(), arguments.pixels, arguments.metres)
    out = Path(arguments.out).absolute()
    for file in render_map(scene, out, arguments.tiles, arguments.geotiff):
        print_line(f"{file} is written")
