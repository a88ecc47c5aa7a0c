# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of height operators: erosion, scree, water, snow and fine relief, on one raster or a tile of it."""
