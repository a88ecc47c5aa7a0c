# SPDX-License-Identifier: GPL-3.0-or-later
"""Text, numbers, plots and pages, independent of any scene."""
