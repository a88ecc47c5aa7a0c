# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter that stands still: points on a terrain as a function of the place and the view."""
