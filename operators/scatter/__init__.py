# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that stand on a terrain: settings, request, operators and the panel."""
