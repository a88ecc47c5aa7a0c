# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk that refines, and what it asks of a diamond."""
