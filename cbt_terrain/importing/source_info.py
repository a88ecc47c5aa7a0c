# SPDX-License-Identifier: GPL-3.0-or-later
"""What a height map's header says, and what is installed: both asked of a child process, as an import is."""

import dataclasses
import json
import os
import platform
import tempfile
import time
from importlib import metadata
from pathlib import Path

from ..errors import TerrainError
from ..field.lands import LANDS
from ..run import child, stopping
from ..run.stall import STALL_SECONDS, stalled_text
from .guard import VARIABLES, guard
from .raster import ImportSettings
from .sources import check_file, open_source

POLL_SECONDS = 0.02


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
    """The child's answer. Raises TerrainError, also where it takes too long or ends without one."""
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as errors, stopping.listening():
        try:
            streams = {"stdout": said, "stderr": errors}
            process = child.start(
                "cbt_terrain.importing.source_info", json.dumps(request), variables=VARIABLES, **streams
            )
        except OSError as reason:
            raise TerrainError(f"No Python process could be started for {what} ({reason}): try again.") from reason
        end = time.monotonic() + STALL_SECONDS
        try:
            while process.poll() is None:
                stopping.check()
                if time.monotonic() > end:
                    raise TerrainError(stalled_text(what))
                time.sleep(POLL_SECONDS)
        finally:
            process.kill()
            process.wait()
            process.stdin.close()
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    answer = json.loads(lines[-1]) if process.returncode == 0 and lines else {}
    if "answer" not in answer:
        raise TerrainError(
            answer.get("error")
            or f"The process that reads {what} ended with code {process.returncode}: the file may be damaged, or "
            "memory may have run out."
        )
    return answer["answer"]


def child_main(request: str) -> None:
    """Answer one request on stdout."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to stderr
    asked = json.loads(request)["settings"]
    try:
        if asked is None:
            answer = {"answer": _of_this_process()}
        else:
            for name in ("raw_size", "extent"):
                asked[name] = tuple(asked[name]) if asked[name] is not None else None
            answer = {"answer": _of_source(ImportSettings(**asked))}
    except TerrainError as error:
        answer = {"error": str(error)}
    except MemoryError:
        answer = {"error": f"Reading {asked['source']} ran out of memory: cut it into tiles or reduce it."}
    except Exception as error:
        answer = {"error": f"Reading {asked['source']} failed unexpectedly ({type(error).__name__}: {error})."}
    with channel:
        channel.write(json.dumps(answer) + "\n")


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
