# SPDX-License-Identifier: GPL-3.0-or-later
"""What accuracy costs: measured and written down."""
