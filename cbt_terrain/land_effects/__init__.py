# SPDX-License-Identifier: GPL-3.0-or-later
"""Height operators, one in a file: its declaration, and the change that it makes to a raster of ground.

`land_effect.py` is the declaration, `catalogue.py` lists them, `levels.py` applies one by levels. `land/` stacks them.
"""
