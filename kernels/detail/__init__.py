# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of terrains with detail below the cells of their rasters: others do not compile them."""
