# SPDX-License-Identifier: GPL-3.0-or-later
"""Program that writes GeoTIFFs: `tiff HEIGHTS.npy OUT.tif STEP`, or `tiff HEIGHTS.npy FOLDER STEP TILES`.

Heights are metres with row 0 in the south, STEP metres apart. The folder gets TILES x TILES files, side by side.
"""

import itertools
import json
import sys
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin

WEST, NORTH, UTM = 500_000.0, 5_000_000.0, "EPSG:32632"


def write(heights: np.ndarray, path: str | Path, step: float, row: int = 0, column: int = 0) -> None:
    """Write heights, row 0 in the north, from a row and a column on."""
    georeference = {"transform": from_origin(WEST + column * step, NORTH - row * step, step, step), "crs": UTM}
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": heights.dtype}
    with rasterio.open(path, "w", driver="GTiff", **shape, **georeference) as file:
        file.write(heights, 1)


if __name__ == "__main__":
    heights, out, step = np.load(sys.argv[1], mmap_mode="r")[::-1], Path(sys.argv[2]), float(sys.argv[3])
    if len(sys.argv) == 4:
        write(heights, out, step)
    else:
        out.mkdir()
        rows, columns = (np.linspace(0, size, int(sys.argv[4]) + 1).astype(int).tolist() for size in heights.shape)
        for top, bottom in itertools.pairwise(rows):
            for left, right in itertools.pairwise(columns):
                write(heights[top:bottom, left:right], out / f"{top}_{left}.tif", step, top, left)
    print(json.dumps({"written": str(out)}))
