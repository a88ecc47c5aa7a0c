# SPDX-License-Identifier: GPL-3.0-or-later
"""Height operators: effects that change heights, stacked and applied by level and by tile.

`height_operator.py` is the declaration, `catalogue.py` lists them, one file has each with its change to a raster of
ground, `levels.py` applies one by levels. `stack.py` combines them, `shape.py` shapes land with a stack into a new
store, and `derived_store.py` keeps such stores as a cache.
"""
