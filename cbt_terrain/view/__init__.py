# SPDX-License-Identifier: GPL-3.0-or-later
"""Views, criteria of refinement, camera paths, and what a pixel spans."""
