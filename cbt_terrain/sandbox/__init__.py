# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes that open files from outside: their start, messages and supervision, and the rights they drop."""
