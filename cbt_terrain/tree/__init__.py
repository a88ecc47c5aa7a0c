# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree, and the bytes of a saved one."""
