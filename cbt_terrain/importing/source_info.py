# SPDX-License-Identifier: GPL-3.0-or-later
"""Summary of a height map's header, and versions of the libraries; a child process reads both."""

import dataclasses
import platform
import tempfile
from importlib import metadata
from pathlib import Path

from ..field import store_folder
from ..field.lands import LANDS
from ..formats.archives import is_archive, unpacked
from ..formats.sources import check_file, open_source
from ..rasters.raster import ImportSettings
from ..rasters.source_formats import all_drivers
from ..run import child
from ..sandbox.guard import guard
from ..sandbox.store_job import ask, serve

MODULE = "cbt_terrain.importing.source_info"  # of the child process


def describe_source(settings: ImportSettings) -> dict:
    """Return a dict of facts of one file, or of a built-in terrain, by its header, which a child process reads.

    Raises TerrainError for a file that cannot be imported.
    """
    settings.check()
    settings.check_file()
    if settings.source not in LANDS:
        check_file(Path(settings.source))
    return ask(MODULE, {"settings": dataclasses.asdict(settings)}, settings.source)


def versions() -> dict:
    """Return the versions of all libraries, and the rights that processes reading height maps drop on this system.

    A child process adds the rights, and the versions of GDAL and PROJ.
    """
    from ... import __version__

    installed = {
        name: _version(name) for name in ("numpy", "warp-lang", "rasterio", "OpenEXR", "laspy", "lazrs", "bpy")
    }
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    program = {"adaptive-terrain": __version__, "Python": platform.python_version(), "system": system}
    return program | installed | ask(MODULE, {"settings": None}, "the versions of GDAL and PROJ")


def _version(name: str) -> str:
    """Return the version of an installed package, "" if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def child_main() -> None:
    """Answer one request on stdin, in a child process that may load GDAL and OpenEXR."""
    serve(_answer, lambda request: f"Reading {request['settings']['source']}")


def _answer(request: dict, *_: object) -> dict:
    """Return the summary of a height map, or GDAL's versions without settings."""
    settings = request["settings"]
    return _gdal_versions() if settings is None else describe_alone(ImportSettings(**settings))


def describe_alone(settings: ImportSettings) -> dict:
    """Return the facts of a height map, in a child process that first gives up its rights.

    Lengths are metres, except `middle`, in the unit of the file's coordinate system. "step_m", "middle" and "crs" are
    absent if the file does not place the raster. An archive is unpacked into the job's folder of temporary files.
    """
    source, scratch = Path(settings.source), Path(tempfile.gettempdir())
    # May read the source alone, and write only what an archive holds, into the scratch folder.
    guard([source], scratch if is_archive(source) else None)
    child.end_with_parent()
    with unpacked(source, scratch / store_folder.new_data_name()) as file:
        raster = open_source(dataclasses.replace(settings, source=str(file)))
        raster.close()
    place, warnings = raster.georeference, raster.warnings
    fields: dict[str, object] = {"path": settings.source, "format": raster.format, "stored": raster.stored}
    fields["raster"] = [raster.width, raster.height]
    if place is not None:
        fields |= {"step_m": [place.step_x, place.step_y], "middle": list(place.middle), "crs": place.crs}
        warnings = [*warnings, *place.warnings, *place.size_warnings]
    return fields | {"warnings": warnings}


def _gdal_versions() -> dict:
    """Return GDAL's version, its drivers that read height maps, and the rights that this process has dropped."""
    import rasterio
    from rasterio import _env

    with rasterio.Env() as env:
        drivers = sorted(all_drivers() & env.drivers().keys())
    rights = guard([Path("any.vrt")], None)  # no file is opened; the name only chooses GDAL
    return {"GDAL": _env.gdal_version(), "GDAL drivers": drivers, "reading height maps": rights}
