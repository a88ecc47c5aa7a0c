# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of attributes: values at points of the surface, for vertices and texels alike."""
