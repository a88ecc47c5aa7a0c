# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of stable scatter: the tile of points, the squares that views may show, and positions on the ground."""
