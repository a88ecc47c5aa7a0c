# SPDX-License-Identifier: GPL-3.0-or-later
"""The state that survives a frame, and its only owner."""
