# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that resample tiles onto the grid of a mosaic."""
