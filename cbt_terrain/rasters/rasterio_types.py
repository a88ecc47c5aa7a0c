# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of rasterio, which has no type hints and is imported only in child processes."""

from typing import Any

CRS = Any  # rasterio.crs.CRS
DatasetReader = Any  # rasterio.DatasetReader, or rasterio.vrt.WarpedVRT
