# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of height maps, which may be damaged or hostile, into stores."""
