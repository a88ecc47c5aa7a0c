# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that measure a mesh; no frame needs them, so they are compiled when someone measures."""
