# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of a scatter (`object.adaptive_scatter`), and the one place that reads them."""

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.scatter.scatter import Scatter
from ..layers.properties import LayerSettings, layer_alone, layers_of
from ..terrain.detail_properties import changed
from .fitting import fit
from .instancing import set_collection

SURFACE, MESH = "SURFACE", "MESH"


def _collection_chosen(self, _context) -> None:
    """Show the collection's objects on the points, as far apart as they are wide."""
    set_collection(self.id_data, self.collection)
    fit(self.id_data)


class ScatterSettings(bpy.types.PropertyGroup):
    """Points on the terrain that is the object's parent."""

    enabled: BoolProperty(name="Adaptive Scatter", description="This object's points are written by Adaptive Terrain")
    collection: PointerProperty(
        name="Collection",
        description="Objects to scatter: each point shows one of them. Spacing, Full Until, Size and Reach follow from "
        "their sizes until you change them",
        type=bpy.types.Collection, update=_collection_chosen,
    )  # fmt: skip
    fitted: FloatVectorProperty(
        name="Fitted", description="Spacing, Full Until, Size and Reach as they were last fitted", size=4,
        options={"HIDDEN"},
    )  # fmt: skip
    spacing: FloatProperty(
        name="Spacing",
        description="Distance between points at full density: one point on a square of this side, in the terrain's own "
        "space. Smaller is denser",
        default=10.0, min=1e-3, soft_max=1000.0, precision=2, unit="LENGTH", update=changed,
    )  # fmt: skip
    full_until: FloatProperty(
        name="Full Until",
        description="Distance from the camera up to which all points exist; further away their number per pixel stays "
        "the same. 0: all points everywhere",
        default=500.0, min=0.0, soft_max=10_000.0, precision=1, unit="LENGTH", update=changed,
    )  # fmt: skip
    use_sea: BoolProperty(
        name="Above the Sea", description="Put no points on ground below the sea", default=False,
        update=changed,
    )  # fmt: skip
    sea_level: FloatProperty(
        name="Sea Level", description="Height of the sea in the terrain's own space", unit="LENGTH", update=changed
    )
    layer: StringProperty(
        name="On Layer",
        description="Scatter only where this layer of the terrain is, as densely as it covers the ground",
        update=changed,
    )
    where: PointerProperty(type=LayerSettings)
    size: FloatProperty(
        name="Size",
        description="Scale of the objects: 1 keeps their size in the world, whatever the terrain's scale",
        default=1.0, min=0.0, soft_max=100.0, update=changed,
    )  # fmt: skip
    variation: FloatProperty(
        name="Variation", description="How much the size varies up and down, as a fraction: 0.2 is 20 %",
        default=0.2, min=0.0, max=1.0,
        subtype="FACTOR", update=changed,
    )  # fmt: skip
    align: FloatProperty(
        name="Align to Ground",
        description="How much the objects tilt with the slope: 0 stands upright, 1 follows the ground's normal",
        default=0.0, min=0.0,
        max=1.0, subtype="FACTOR", update=changed,
    )  # fmt: skip
    roots: EnumProperty(
        name="Roots On",
        description="What the objects stand on",
        items=[(SURFACE, "Ground", "The heights of the height map: objects never move, but may be as far off the mesh "
                "as its error"),
               (MESH, "Mesh", "The triangles of the mesh: objects move up and down with them")],
        update=changed,
    )  # fmt: skip
    margin_deg: FloatProperty(
        name="Margin",
        description="How far outside the camera's frame points still exist, in degrees: for shadows and fast cameras",
        default=5.0, min=0.0, max=89.0, precision=1, update=changed,
    )  # fmt: skip
    margin_m: FloatProperty(
        name="Reach", description="The same in metres: how far the objects and their shadows reach",
        default=0.0, min=0.0, soft_max=100.0, unit="LENGTH", update=changed,
    )  # fmt: skip
    cull_hidden: BoolProperty(
        name="Cull Hidden", description="Leave out objects that hills hide from the camera; set Reach to their height "
        "first. Keep it off where hidden objects cast shadows into view or show in mirrors. It needs a Screen Error, "
        "roots on the ground, and nothing cut away",
        default=False, update=changed,
    )  # fmt: skip
    seed: IntProperty(
        name="Seed", description="Another number gives another random pattern", default=0, min=0, update=changed
    )


def scatter_of(settings, terrain_settings) -> Scatter:
    """Return the engine's Scatter of evaluated settings.

    terrain_settings: settings of the terrain below the scatter; one of its layers may limit the scatter. Raises
    TerrainError for a layer that the terrain lacks, and for invalid layers and numbers.
    """
    layers, on = (), -1  # on: number of the layer that limits the scatter, -1 for none
    if settings.layer:
        layers = layers_of(terrain_settings)
        names = [layer.name for layer in layers]
        if settings.layer not in names:
            raise TerrainError(f"Its layer {settings.layer!r} is none of the terrain's", fix="choose another")
        on = names.index(settings.layer)
    numbers = {name: getattr(settings, name) for name in ("spacing", "full_until", "size", "variation", "align")}
    margins = {"margin_deg": settings.margin_deg, "margin_m": settings.margin_m}
    return Scatter(where=layer_alone(settings.where), layers=layers, on=on, seed=settings.seed, **numbers, **margins)
