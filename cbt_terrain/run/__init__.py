# SPDX-License-Identifier: GPL-3.0-or-later
"""Services for all rooms: launches, buffers, child processes, files while they are written, requests to stop."""
