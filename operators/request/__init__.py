# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene in, plain numbers for the engine out: cameras, land, effects, scatters, as the settings ask for them."""
