# SPDX-License-Identifier: GPL-3.0-or-later
"""Counting leaves without making them, to keep to a number of triangles."""
