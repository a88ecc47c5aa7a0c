# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field: samples on their lattice, errors and ranges of heights, and the store that holds them."""
