# SPDX-License-Identifier: GPL-3.0-or-later
"""Program that writes a GeoTIFF: `tiff HEIGHTS.npy OUT.tif STEP`.

Heights are metres with row 0 in the south, STEP metres apart.
"""

import json
import sys

import numpy as np
import rasterio
from rasterio.transform import from_origin

WEST, NORTH, UTM = 500_000.0, 5_000_000.0, "EPSG:32632"

if __name__ == "__main__":
    heights = np.load(sys.argv[1], mmap_mode="r")[::-1]
    step = float(sys.argv[3])
    georeference = {"transform": from_origin(WEST, NORTH, step, step), "crs": UTM}
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": heights.dtype}
    with rasterio.open(sys.argv[2], "w", driver="GTiff", **shape, **georeference) as file:
        file.write(heights, 1)
    print(json.dumps({"written": sys.argv[2]}))
