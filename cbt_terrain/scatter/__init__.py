# SPDX-License-Identifier: GPL-3.0-or-later
"""Stable scatter: points on a terrain as a function of the declaration, the terrain and the views."""
