# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that rise to their places as the view comes nearer."""
