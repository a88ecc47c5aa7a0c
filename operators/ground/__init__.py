# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground as objects meet it: drop them, keep them there, pick it, measure it, see from it, let things fall."""
