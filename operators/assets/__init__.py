# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset library: materials, node groups, plants and rocks in the Asset Browser."""
