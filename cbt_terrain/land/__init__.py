# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape of land: effects that change heights, stacked, by level and by tile, into a store of their own."""
