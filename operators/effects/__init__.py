# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects in Blender: the settings of a terrain's effects, its material, its baked maps."""
