# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects on heights, one file an effect: what each is declared as, and the change it makes to a raster of ground.

`land_effect.py` is the declaration, `catalogue.py` lists them, `levels.py` applies one by levels. `land/` stacks them.
"""
