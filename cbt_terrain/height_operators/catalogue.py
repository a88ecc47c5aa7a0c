# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of all height operators. A new one is a file in this folder and an entry in this list, or is registered."""

from ..errors import check_free_name
from .droplets import DROPLETS
from .flood import FLOOD
from .height_operator import HeightOperator
from .relief import RELIEF
from .rivers import RIVERS
from .snow import SNOW
from .thermal import THERMAL
from .water import WATER

# In the usual order of a stack.
HEIGHT_OPERATORS: dict[str, HeightOperator] = {
    effect.name: effect for effect in (RIVERS, THERMAL, DROPLETS, RELIEF, WATER, FLOOD, SNOW)
}


def register_height_operator(operator: HeightOperator) -> None:
    """Add a height operator to the list.

    It appears in menus if it is registered before the extension is enabled.

    Raises:
        TerrainError: the name is taken or is no identifier.
    """
    check_free_name("height operator", operator.name, HEIGHT_OPERATORS)
    HEIGHT_OPERATORS[operator.name] = operator


def unregister_height_operator(name: str) -> None:
    """Remove a registered height operator from the list; do nothing if it is not there."""
    HEIGHT_OPERATORS.pop(name, None)
