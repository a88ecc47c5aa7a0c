# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement of a height field for a set of views."""
