# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter points on a terrain: settings, request, operators and the panel."""
