# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects in Blender: a terrain's splat layers, its material, its baked maps, its scatters."""
