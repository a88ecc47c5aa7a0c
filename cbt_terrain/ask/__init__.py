# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked: where it is seen from, and how fine it shall be."""
