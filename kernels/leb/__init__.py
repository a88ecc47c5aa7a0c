# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection: from heap ids to triangles, neighbours and diamonds."""
