# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk that refines, and the criterion that it tests on diamonds."""
