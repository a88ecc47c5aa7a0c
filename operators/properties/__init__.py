# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that Blender saves in its files: identifiers, ranges, labels and tooltips."""
