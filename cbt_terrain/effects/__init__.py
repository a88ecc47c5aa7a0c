# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects: what a material, a modifier or a map may read of a terrain. Only what is read is computed (`evaluate/`).

An effect is a declaration and a function over arrays (`effect.py`), one file a function; `catalogue.py` lists them.
"""
