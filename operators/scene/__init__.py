# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene around a terrain: sun, sky, camera and material by one button."""
