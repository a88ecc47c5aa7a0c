# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a terrain for materials, modifiers and maps. Only those that something reads are computed
(`evaluate/`).

An attribute is a declaration (`effect.py`) and a function over arrays, one file for each function; `catalogue.py` lists
them.
"""
