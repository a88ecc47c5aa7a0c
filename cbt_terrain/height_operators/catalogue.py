# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of all height operators. A new one is a file in this folder and an entry in this list, or is registered."""

from ..errors import check_free_name, check_kind
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

# Earlier names of operators in files and scripts. Keys of stored land contain them, so that it stays valid.
RENAMED = {"thermal": "scree"}


def operator_of(name: str) -> HeightOperator | None:
    """Return the height operator with this name or earlier name, None if there is none."""
    return HEIGHT_OPERATORS.get(RENAMED.get(name, name))


def key_name(name: str) -> str:
    """Return the name of a height operator in keys of stored land: the earlier one, if it had another."""
    return next((before for before, now in RENAMED.items() if now == name), name)


def register_height_operator(operator: HeightOperator) -> None:
    """Add a height operator to the list.

    It appears in menus if it is registered before the extension is enabled.

    Raises:
        TerrainError: the name is taken or is no identifier.
    """
    check_kind(operator, HeightOperator, "The height operator", "a HeightOperator")
    check_free_name("height operator", operator.name, {*HEIGHT_OPERATORS, *RENAMED})
    HEIGHT_OPERATORS[operator.name] = operator


def unregister_height_operator(name: str) -> None:
    """Remove a registered height operator from the list; do nothing if it is not there."""
    HEIGHT_OPERATORS.pop(name, None)
