# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that a scene reads: settings, request, sun lamps and the panel."""
