# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading of many height maps in the import's sandbox, one forked process for each."""

import json
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import json, os, signal, sys, traceback
import numpy
import rasterio  # without registering a driver
import adaptive_terrain.kernels  # which guards import: 0.6 s in each fork
from pathlib import Path
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.sandbox import guard
from adaptive_terrain.cbt_terrain.formats import sources
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings

def read(path):
    for descriptor in (1, 2):  # some drivers print
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
    try:
        guard.guard([Path(path)], None)
        raster = sources.open_source(ImportSettings(path))
        if raster.width * raster.height > 1 << 22:
            return ["error", "too large to read here."]
        rows = raster.read(0, raster.height) * raster.scale + raster.offset
        return ["read", [raster.width, raster.height, float(numpy.nansum(rows)), int(numpy.isnan(rows).sum())]]
    except TerrainError as error:
        return ["error", str(error)]
    except BaseException:
        return ["traceback", traceback.format_exc()[-600:]]

for path in sys.stdin.read().split("\\0"):
    end, begin = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(120)
        os.write(begin, json.dumps(read(path)).encode())
        os._exit(0)
    os.close(begin)
    text = b""
    while piece := os.read(end, 1 << 16):
        text += piece
    os.close(end)
    status = os.waitpid(child, 0)[1]
    print(text.decode() or json.dumps(["died", status]), flush=True)
"""


def read_in_sandbox(files: list[Path]) -> list[list]:
    """Return what became of each file.

    That is ["read", [columns, rows, sum, missing]], ["error", sentence], ["traceback", text] or ["died", status].
    """
    names = "\0".join(map(str, files))
    command = [sys.executable, "-W", "ignore", "-c", PROGRAM]
    done = subprocess.run(command, input=names, capture_output=True, text=True, timeout=1200)
    lines = done.stdout.splitlines()
    assert len(lines) == len(files), done.stderr
    return [json.loads(line) for line in lines]
