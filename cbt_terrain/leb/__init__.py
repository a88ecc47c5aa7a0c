# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection of a lattice's root squares, and point location in it."""
