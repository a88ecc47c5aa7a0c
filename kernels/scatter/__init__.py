# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that stand still: the tile that they repeat, which of it a view may see, and where they are on the ground."""
