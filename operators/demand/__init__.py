# SPDX-License-Identifier: GPL-3.0-or-later
"""Demand: which attributes of an object's mesh a scene reads, and who reads them.

`demand.py` gathers it: materials (`materials.py`), modifiers and geometry nodes (`geometry.py`), drivers, open windows.
What node trees read is found by one walk backwards (`walk.py`) from what is used, through the links of `trees.py`;
`readers.py` says what each node reads, `inputs.py` which of its inputs count. `kept.py` keeps the result until
something that it depends on changes. What cannot be known counts as everything, with its reason.
"""
