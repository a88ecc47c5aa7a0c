# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of displacement below the cells of a raster, compiled on first use."""
