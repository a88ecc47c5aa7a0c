# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that effects shape: the stack as a list, its presets, the shaping, its cache, its water."""
