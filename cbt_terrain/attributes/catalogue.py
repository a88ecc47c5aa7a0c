# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of all attributes. A new one is a file in this folder and an entry in this list, or is registered."""

from ..errors import TerrainError, check_free_name, check_kind
from . import color, flow, jet, layers, occlusion, sky, splat, sun, wetness
from .attribute import AttributeDeclaration

ATTRIBUTES: dict[str, AttributeDeclaration] = {
    effect.name: effect
    for effect in (
        *jet.JETS,
        flow.FLOW,
        wetness.WETNESS,
        *splat.SPLATS,
        color.COLOR,
        sky.SKY,
        occlusion.OCCLUSION,
        sun.SUN,
        *layers.LAYERS,
    )
}


def register_attribute(attribute: AttributeDeclaration) -> None:
    """Add an attribute to the list.

    Its parameters get rows in panels if it is registered before the extension is enabled.

    Raises:
        TerrainError: the name is taken or is no identifier, or an attribute that it reads is not registered.
    """
    check_kind(attribute, AttributeDeclaration, "The attribute", "an AttributeDeclaration")
    check_free_name("attribute", attribute.name, ATTRIBUTES)
    unknown = [name for name in attribute.reads if name not in ATTRIBUTES]
    if unknown:
        what = f"The attribute {attribute.name!r} reads {unknown[0]!r}, which is not registered"
        raise TerrainError(what, expected=f"one of {', '.join(ATTRIBUTES)}", fix="register that first")
    ATTRIBUTES[attribute.name] = attribute


def unregister_attribute(name: str) -> None:
    """Remove a registered attribute from the list; do nothing if it is not there."""
    ATTRIBUTES.pop(name, None)
