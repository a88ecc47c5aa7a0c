# SPDX-License-Identifier: GPL-3.0-or-later
"""Many height maps as one raster: a catalogue of their headers, a target grid, and a resampler for any window of it."""
