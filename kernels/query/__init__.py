# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of queries: heights and normals at places, rays against the surface, ranges of boxes, what an eye sees."""
