# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of scatters, in the order of their registration."""

from .operators import AddScatter, on_load
from .properties import ScatterSettings
from .starter import AddStarterCollection

CLASSES = (ScatterSettings, AddScatter, AddStarterCollection)
HANDLERS = (("load_post", on_load),)
