# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of render farms, in the order of their registration."""

from .submit_to_farm import SubmitToFarm

CLASSES = (SubmitToFarm,)
HANDLERS = ()
