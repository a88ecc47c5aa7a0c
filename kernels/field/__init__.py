# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of a raster's errors and ranges, and the surface between its samples."""
