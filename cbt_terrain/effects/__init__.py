# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects: what a material, a modifier or a map may read of a terrain, and that only what is read is computed.

An effect is a declaration and a function over arrays (`effect.py`), one file a function; `catalogue.py` lists them.
`plan.py` says which of them a scene's demand calls for, and why; `evaluate.py` runs those, each once.
"""
