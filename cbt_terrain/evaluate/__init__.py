# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of requested attributes: each once, at the scale of its readers.

`plan.py` finds the attributes that requests need; `evaluate.py` computes them.
"""
