# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs `import` and `info`."""

import os
import sys
import time
from dataclasses import fields
from pathlib import Path

from ..text.console import Progress, duration, print_json, print_line
from .verbs import UsageError, print_fields

# Tiles in a task of a farm's job. A task takes 5 s of processor time to start and 2 s to measure a tile of 2048 x 2048
# samples, so that its start is a sixth of the work; with 4 tiles it is two fifths.
TASK_TILES = 12


def run_import(arguments) -> None:
    """Run the verb `import`: turn height maps or a built-in land into a store, and print the report.

    With --only it does one part of that; with --job it writes a farm's job for it instead. Raises UsageError.
    """
    from ...cbt_terrain.importing.covered import COVERED
    from ...cbt_terrain.importing.import_process import import_source
    from ...cbt_terrain.importing.tile_import import TILED_PARTS, ImportPart

    settings = _import_settings(arguments, arguments.sources)
    if bool(arguments.tiles) != (arguments.only in TILED_PARTS):
        raise UsageError(f"--tiles A-B belongs to --only {' and --only '.join(TILED_PARTS)}")
    if arguments.chunk and not arguments.job:
        raise UsageError("--chunk belongs to --job")
    if arguments.quick and (arguments.job or arguments.only):
        raise UsageError("--quick loads one piece, and --job and --only are of several")
    if arguments.job:
        for line in _write_import_job(arguments, settings):
            print_line(line)
        return
    part = ImportPart(arguments.only, frozenset(arguments.tiles)) if arguments.only else None
    start = time.monotonic()
    previews: list[dict] = []

    def on_preview(preview: dict) -> None:
        """Print the fields that are known before the import."""
        previews.append(preview)
        print_fields(preview)

    with Progress(1.0, "import", arguments.progress) as bar:
        report = import_source(settings, arguments.store, lambda fraction, _message: bar.to(fraction), on_preview, part)
    if part is not None:
        print_fields(report)
        return
    printed = previews[0] if previews else {}  # only fields and warnings that are new or have changed are printed again
    report["warnings"] = [text for text in report.get("warnings", []) if text not in printed.get("warnings", ())]
    report.pop("seconds", None)  # without the start and the headers, which are in the time of the last line
    report.pop(COVERED, None)  # 16,384 digits
    print_fields({name: value for name, value in report.items() if printed.get(name) != value})
    print_line(f"{arguments.store} is ready after {duration(time.monotonic() - start)}")


def _write_import_job(arguments, settings) -> list[str]:
    """Write the job of an import for a farm, and return lines about it."""
    from ...cbt_terrain.mosaic.mosaic_info import describe_heights
    from ..farm.import_job import write_import_job

    described = describe_heights(settings)
    chunk = arguments.chunk or TASK_TILES
    return write_import_job(settings, described["raster"], arguments.store, arguments.job, chunk)


def run_info(arguments) -> None:
    """Run the verb `info`: print the versions, or the description of a store, height maps or an exported .npz.

    With --verify a store is checked first. Raises UsageError.
    """
    if arguments.versions == bool(arguments.paths):
        raise UsageError("expected the path of a store, a height map or an exported .npz, or --versions")
    is_store = len(arguments.paths) == 1 and _is_store(arguments.paths[0])
    if arguments.verify:
        if not is_store:
            raise UsageError(f"--verify checks a store, and {', '.join(arguments.paths)} is none")
        _verify_store(arguments.paths[0])
    fields = _all_versions() if arguments.versions else _described(arguments, is_store)
    if arguments.as_json:
        print_json(fields)
    else:
        print_fields(fields)


def _is_store(path: str) -> bool:
    """Return whether a path is a folder without height maps: `describe` reports it if it is no store or damaged."""
    from ...cbt_terrain.importing.source_list import holds_height_maps

    return os.path.isdir(path) and not holds_height_maps(path)


def _described(arguments, is_store: bool) -> dict:
    """Return the description of a store (is_store), an exported mesh, a height map or a mosaic of several.

    Raises UsageError for an option that the height map's format does not have.
    """
    paths = arguments.paths
    is_mesh = len(paths) == 1 and Path(paths[0]).suffix == ".npz"
    if (is_store or is_mesh) and _given(arguments):
        raise UsageError(f"{paths[0]} is no height map, so it has no options of an import")
    if is_store:
        from ...cbt_terrain.importing.import_report import describe

        return describe(Path(paths[0]))
    if is_mesh:
        from ...cbt_terrain.mesh.archive import read_npz

        return read_npz(Path(paths[0]))["info"]
    from ...cbt_terrain.mosaic.mosaic_info import describe_heights

    return describe_heights(_import_settings(arguments, paths))


def _verify_store(path) -> None:
    """Check every block of a store against its checksum, and print the number of blocks of each array.

    Raises TerrainError if one differs.
    """
    from ...cbt_terrain.field.verification import verify

    blocks = verify(path)
    print_line(f"every checksum holds: {', '.join(f'{name} {count}' for name, count in blocks.items())} blocks")


def _all_versions() -> dict:
    """Return the versions of the program's parts by name, with Blender's if it is loaded."""
    from ...cbt_terrain.importing.source_info import versions

    bpy = sys.modules.get("bpy")
    return versions() | ({"Blender": bpy.app.version_string} if bpy is not None else {})


def _import_settings(arguments, sources: list[str]):
    """Return ImportSettings from the arguments of the same names. Raises UsageError for one without effect."""
    from ...cbt_terrain.errors import TerrainError
    from ...cbt_terrain.formats.file_options import UNUSED
    from ...cbt_terrain.importing.source_list import check_options
    from ...cbt_terrain.rasters.raster import ImportSettings

    given = _given(arguments)
    settings = ImportSettings(source=sources[0], more_sources=tuple(sources[1:]), **given)
    try:
        check_options(settings, given)
    except TerrainError as error:
        raise UsageError(str(error)) if error.code == UNUSED else error from None
    return settings


def _given(arguments) -> dict:
    """Return the arguments that are settings of an import, by name, without those that were not given."""
    from ...cbt_terrain.rasters.raster import ImportSettings

    values = {field.name: (getattr(arguments, field.name, None), field.default) for field in fields(ImportSettings)}
    # A flag that was not given has its default, other arguments are None.
    return {
        name: value
        for name, (value, default) in values.items()
        if value is not None and not (isinstance(value, bool) and value == default)
    }
