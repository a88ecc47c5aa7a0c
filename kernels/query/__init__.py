# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of queries: heights and normals at points, rays against the surface, ranges of boxes, visible samples."""
