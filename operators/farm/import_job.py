# SPDX-License-Identifier: GPL-3.0-or-later
"""A job of Open Job Description that imports height maps: begin, read, fill, measure, publish."""

import dataclasses
import json
import os
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field.lands import LANDS
from ...cbt_terrain.importing.import_work import count_tiles
from ...cbt_terrain.importing.source_list import files_of
from ...cbt_terrain.importing.tile_import import TILED_PARTS
from ...cbt_terrain.rasters.raster import ImportSettings
from ..export.exporting import make_folder, write_files
from ..export.formats import range_text
from .bundle import OPENJD_VALUES, TEMPLATE, read_template, to_yaml_json

TIMEOUT_S = 86_400
# Options of the verb `import` that are not spelled like their setting.
OPTIONS = {"raw_dtype": "raw-type", "raw_little_endian": "big-endian", "blend": "no-blend"}
POSITIONAL = "source", "more_sources"


def write_import_job(settings: ImportSettings, size: Sequence[int], store: Path, folder: Path, chunk: int) -> list[str]:
    """Write the job of an import into `folder`, and return lines about it for the user.

    size: columns and rows of the raster. store: folder that the job writes. chunk: tiles of one task. Raises
    TerrainError for files that cannot be written, and for a folder in the store, which holds no other files.
    """
    if Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(store)):
        what = f"The job's folder {shown(folder)} is, or is inside, the store's folder"
        raise TerrainError(what, fix="choose another folder (--job)")
    tiles = count_tiles(size)
    values = {"StoreDir": str(store.absolute()), "Tiles": range_text(range(tiles)), "ChunkSize": str(chunk)}
    make_folder(folder)
    write_files(folder, {TEMPLATE: import_template(settings), OPENJD_VALUES: to_yaml_json(values)})
    path = folder.absolute()
    command = f"openjd run {shlex.quote(str(path / TEMPLATE))} --step Publish --run-dependencies"
    return [
        f"{folder} is a job of {tiles:,} tiles, {chunk} a task",
        f"to run it on this machine: {command} --job-param {shlex.quote(f'file://{path / OPENJD_VALUES}')}",
    ]


def import_template(settings: ImportSettings) -> str:
    """Return the template of an import's job as YAML. Raises TerrainError for a source that a job cannot name."""
    arguments = import_arguments(settings)
    if any("{{" in text for text in arguments):
        raise TerrainError("A source has {{ in its name, which a job reads as a variable", fix="rename it")

    def action(found: re.Match) -> str:
        """Return the lines of a step's command. found: match of @ACTION@ or @ACTION PART@, a part of the import."""
        part = found[1].split()
        tiles = ["--tiles", "{{Task.Param.Tile}}"] if part and part[0] in TILED_PARTS else []
        words = ["--command", "adaptive_terrain", "import", "--store", "{{Param.StoreDir}}", "--progress", "openjd"]
        words += [*(["--only", *part, *tiles] if part else []), *arguments]
        on_run = {"command": "{{Param.Blender}}", "args": words, "timeout": TIMEOUT_S}
        on_run["cancelation"] = {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": 15}
        return f"script: {to_yaml_json({'actions': {'onRun': on_run}}, indent=None).strip()}"

    chunks = {"defaultTaskCount": "{{Param.ChunkSize}}", "rangeConstraint": "CONTIGUOUS"}
    tile = {"name": "Tile", "type": "CHUNK[INT]", "range": "{{Param.Tiles}}", "chunks": chunks}
    text = read_template("import_job.yaml")
    text = text.replace("@TILES@", f"parameterSpace: {json.dumps({'taskParameterDefinitions': [tile]})}")
    return re.sub("@ACTION([ a-z]*)@", action, text)


def import_arguments(settings: ImportSettings) -> list[str]:
    """Return the arguments of the verb `import` for settings: options, and then the sources with absolute paths.

    Settings with their default are left out. A tuple is written with x between its numbers, a flag without a value.
    """
    words = []
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if field.name in POSITIONAL or value == field.default:
            continue
        words.append(f"--{OPTIONS.get(field.name, field.name).replace('_', '-')}")
        if isinstance(value, tuple):
            words.append("x".join(map(repr, value)))
        elif not isinstance(value, bool):
            words.append(str(value))
    sources = [settings.source] if settings.source in LANDS else files_of(settings)
    return [*words, *map(str, sources)]
