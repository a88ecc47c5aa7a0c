# SPDX-License-Identifier: GPL-3.0-or-later
"""Goals, tables and the pages on performance."""
