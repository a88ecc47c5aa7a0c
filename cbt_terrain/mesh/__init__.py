# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh of a refinement, and the file that holds one."""
