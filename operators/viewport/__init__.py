# SPDX-License-Identifier: GPL-3.0-or-later
"""Viewports: meshes that follow the view and get finer while it rests, and views that frame a terrain."""
