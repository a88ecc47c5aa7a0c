# SPDX-License-Identifier: GPL-3.0-or-later
"""Views, criteria of refinement, camera paths, and pixel footprints."""
