# SPDX-License-Identifier: GPL-3.0-or-later
"""What is made of rows: goals, tables, charts, the page on performance."""
