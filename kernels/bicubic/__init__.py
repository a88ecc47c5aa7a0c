# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the bicubic surface, compiled on first use."""
