# SPDX-License-Identifier: GPL-3.0-or-later
"""Words, numbers and pages: nothing here knows a scene."""
