# SPDX-License-Identifier: GPL-3.0-or-later
"""The measured distance of a delivered mesh from the reference surface."""
