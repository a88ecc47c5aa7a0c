# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels: arrays and numbers in, arrays out. No files, no state, no bpy."""

import warp as wp

wp.config.log_level = wp.LOG_ERROR  # Warp would announce itself, and miss a GPU, in every process
