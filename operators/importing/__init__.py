# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a terrain comes from: a built-in land or a height map, and its store beside the file."""
