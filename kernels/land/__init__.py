# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects that change heights: erosion, scree, water, snow and detail, on one raster or a tile of it."""
