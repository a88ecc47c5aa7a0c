# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of height maps, which may be damaged or hostile: each format as a raster of heights."""
