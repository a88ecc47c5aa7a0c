# SPDX-License-Identifier: GPL-3.0-or-later
"""From a height map, which may be damaged or hostile, to a store."""
