# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies and ranges of a raster by tile: the bytes of a field built in memory, with bounded memory."""
