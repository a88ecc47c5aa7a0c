# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a terrain for materials, modifiers and maps. Only those that something reads are computed.

An attribute is a declaration (`attribute.py`) and a function over arrays, one file for each function; `catalogue.py`
lists them. `plan.py` finds the attributes that requests need, `evaluate.py` computes each once at the scale of its
readers, `bake.py` bakes them into images.
"""
