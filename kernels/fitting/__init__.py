# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the fit; no frame needs them, so they are compiled when someone fits."""
