# SPDX-License-Identifier: GPL-3.0-or-later
"""A raster of heights: settings of its import, and its grid, units, rounding and other facts that files state."""
