# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies and ranges of a large raster by tile: the bytes of a build in one piece, in bounded memory."""
