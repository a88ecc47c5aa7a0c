# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain with a folder for its maps."""

from map_scenes import terrain  # noqa: F401
