# SPDX-License-Identifier: GPL-3.0-or-later
"""From leaves to a mesh: welding, meshlets, displacement."""
