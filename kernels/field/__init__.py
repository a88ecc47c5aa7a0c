# SPDX-License-Identifier: GPL-3.0-or-later
"""What is computed of a raster once, and the surface between its samples."""
