# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers: settings, images, decals, the material and the panel."""
