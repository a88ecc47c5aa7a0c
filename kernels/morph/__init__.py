# SPDX-License-Identifier: GPL-3.0-or-later
"""Geomorphing: new points move from the edge that they split to the surface as the view comes nearer."""
