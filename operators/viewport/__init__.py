# SPDX-License-Identifier: GPL-3.0-or-later
"""What windows show: meshes that follow their views, better when these rest, and views brought to a terrain."""
