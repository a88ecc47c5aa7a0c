# SPDX-License-Identifier: GPL-3.0-or-later
"""What everything runs on: launches, buffers, child processes, files that are being written, a wish to stop."""
