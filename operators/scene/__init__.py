# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's terrains: their settings, what they ask for, their meshes, and what changes them."""
