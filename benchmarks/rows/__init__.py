# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows, one file a topic. Each is a function that measures, and measures anew whenever it is called."""
