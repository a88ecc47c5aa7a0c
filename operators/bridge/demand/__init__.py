# SPDX-License-Identifier: GPL-3.0-or-later
"""Demand: the attributes of an object's mesh that a scene reads, each with its readers.

`demand.py` gathers it from materials (`materials.py`), modifiers and geometry nodes (`geometry.py`), drivers and open
windows. A walk (`walk.py`) goes backwards through a node tree from its used outputs, along the links in `trees.py`.
`readers.py` lists the attributes that each node reads, and `inputs.py` the inputs that matter. `demand_cache.py` caches
the demand until one of its sources changes. An unknown reader counts as reading everything, with the reason.
"""
