# SPDX-License-Identifier: GPL-3.0-or-later
"""What a height map's header says, and what is installed: both asked of a child process, as an import is."""

import dataclasses
import platform
from importlib import metadata
from pathlib import Path

from ..field.lands import LANDS
from ..run import child
from .guard import guard
from .raster import ImportSettings
from .sources import check_file, open_source
from .store_job import ask, serve


def describe_source(settings: ImportSettings) -> dict:
    """What a height map holds by its header, as a flat dict. Raises TerrainError for one that cannot be imported."""
    settings.check()
    if settings.source not in LANDS:
        check_file(Path(settings.source))
    return _ask({"settings": dataclasses.asdict(settings)}, settings.source)


def versions() -> dict:
    """Versions of what reads and makes a terrain, and what the process that reads height maps gives up here."""
    from ... import __version__

    installed = {name: _version(name) for name in ("numpy", "warp-lang", "rasterio", "OpenEXR", "bpy")}
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    own = {"adaptive-terrain": __version__, "Python": platform.python_version(), "system": system}
    return own | installed | _ask({"settings": None}, "the versions of GDAL and PROJ")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _ask(request: dict, what: str) -> dict:
    return ask("cbt_terrain.importing.source_info", request, what)


def child_main() -> None:
    """Answer one request."""
    serve(_answer, lambda asked: f"Reading {asked['settings']['source']}")


def _answer(asked: dict, *_) -> dict:
    settings = asked["settings"]
    if settings is None:
        return _of_this_process()
    for name in ("raw_size", "extent"):
        settings[name] = tuple(settings[name]) if settings[name] is not None else None
    return _of_source(ImportSettings(**settings))


def _of_source(settings: ImportSettings) -> dict:
    guard(Path(settings.source).suffix.lower(), None)
    child.end_with_parent()
    raster = open_source(settings)
    try:
        place = raster.georeference
        fields = {"path": settings.source, "format": raster.format, "stored": raster.stored}
        fields["raster"] = [raster.width, raster.height]
        if place is not None:
            fields |= {"step_m": [place.step_x, place.step_y], "middle": list(place.middle), "crs": place.crs}
        return fields | {
            "warnings": [*raster.warnings, *((*place.warnings, *place.size_warnings) if place is not None else ())]
        }
    finally:
        raster.close()


def _of_this_process() -> dict:
    """What only a process can say that has loaded GDAL: its version, its drivers, and what it has given up."""
    import rasterio
    from rasterio import _env

    given_up = guard(".vrt", None)
    with rasterio.Env() as env:
        drivers = sorted(env.drivers())
    return {"GDAL": _env.gdal_version(), "GDAL drivers": drivers, "reading height maps": given_up}
