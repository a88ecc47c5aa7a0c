# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree: its bitfield, its sum reduction, queries and edits."""
