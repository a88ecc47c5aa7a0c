# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of splat layers, in the order of their registration."""

from ..terrain.displacement_properties import DisplacementSettings
from .images import forget, forget_changed
from .operators import AddLayer, AddPreset, MoveLayer, RemoveLayer
from .panel import LayerList, LayerPresets
from .properties import BANDS, AspectSettings, LayerSettings
from .terrain_material import TerrainMaterial

CLASSES = (
    *(*BANDS.values(), AspectSettings, DisplacementSettings, LayerSettings),
    *(AddLayer, RemoveLayer, MoveLayer, AddPreset, TerrainMaterial, LayerList, LayerPresets),
)
HANDLERS = (("depsgraph_update_post", forget_changed), ("load_post", forget))
