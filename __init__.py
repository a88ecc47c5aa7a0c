# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive Terrain: a terrain at exactly the detail that the camera can see, as an ordinary Blender mesh.

The repository's root is this package. Blender calls `register` and `unregister`; nothing here imports bpy before that,
so that the engine runs, tests and benchmarks without Blender. Most programs need only the names below:

    from adaptive_terrain import Criterion, Terrain, View, bake, import_source, open_store

They are imported when they are first used, so that Blender starts as fast as without them. `examples/` uses each.
"""

__version__ = "0.3.0"

# Name -> the module that it is from.
_FRONT_DOOR = {
    "import_source": "importing.import_process",  # a height map to a store
    "ImportSettings": "rasters.raster",  # ... and how
    "open_store": "field.store",  # a store to a height field
    "Terrain": "terrain",  # a height field to its mesh for
    "View": "view.view",  # what cameras see
    "Criterion": "view.criterion",  # and how fine that is to be
    "bake": "fit.fit",  # a height field to a mesh without a camera
    "measure": "accuracy.measure",  # how accurate a mesh is, without the code that makes bounds
    "write_npz": "mesh.archive",  # a mesh to a file
    "read_npz": "mesh.archive",  # ... and back
    "ground_at": "query.ground",  # heights, normals and slopes at positions of a height field
    "profile": "query.ground",  # ... and heights along a line
    "pick": "query.rays",  # where rays meet it
    "nearest": "query.rays",  # ... along a direction, to either side
    "box_range": "query.box",  # its least and greatest height in a box
    "viewshed": "query.viewshed",  # which of its samples an eye sees
    "Scatter": "scatter.scatter",  # what stands on it,
    "scatter_points": "scatter.points",  # ... where,
    "Layer": "attributes.splat_rules",  # ... and how densely,
    "Rule": "attributes.splat_rules",  # ... by rules
    "register_attribute": "attributes.catalogue",  # to add an attribute,
    "register_height_operator": "height_operators.catalogue",  # ... and an operator on heights
    "TerrainError": "errors",  # raised for whatever cannot be used, with what to do
}
__all__ = [
    "Criterion",
    "ImportSettings",
    "Layer",
    "Rule",
    "Scatter",
    "Terrain",
    "TerrainError",
    "View",
    "bake",
    "box_range",
    "ground_at",
    "import_source",
    "measure",
    "nearest",
    "open_store",
    "pick",
    "profile",
    "read_npz",
    "register_attribute",
    "register_height_operator",
    "scatter_points",
    "viewshed",
    "write_npz",
]

TYPE_CHECKING = False  # type checkers take it for typing's, which would have to be imported
if TYPE_CHECKING:
    from .cbt_terrain.accuracy.measure import measure
    from .cbt_terrain.attributes.catalogue import register_attribute
    from .cbt_terrain.attributes.splat_rules import Layer, Rule
    from .cbt_terrain.errors import TerrainError
    from .cbt_terrain.field.store import open_store
    from .cbt_terrain.fit.fit import bake
    from .cbt_terrain.height_operators.catalogue import register_height_operator
    from .cbt_terrain.importing.import_process import import_source
    from .cbt_terrain.mesh.archive import read_npz, write_npz
    from .cbt_terrain.query.box import box_range
    from .cbt_terrain.query.ground import ground_at, profile
    from .cbt_terrain.query.rays import nearest, pick
    from .cbt_terrain.query.viewshed import viewshed
    from .cbt_terrain.rasters.raster import ImportSettings
    from .cbt_terrain.scatter.points import scatter_points
    from .cbt_terrain.scatter.scatter import Scatter
    from .cbt_terrain.terrain import Terrain
    from .cbt_terrain.view.criterion import Criterion
    from .cbt_terrain.view.view import View


def __getattr__(name: str) -> object:
    if name not in _FRONT_DOOR:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".cbt_terrain.{_FRONT_DOOR[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_FRONT_DOOR])


def register() -> None:
    """Add properties, panels, operators, handlers and the command to Blender."""
    import gc
    from importlib.util import find_spec

    if find_spec("warp") is None:  # it is imported with the first terrain, which would be late for this error
        raise ModuleNotFoundError("No module named 'warp'", name="warp")
    # Nothing of what is imported and registered is garbage. Looking for some takes a third of the time.
    collecting = gc.isenabled()
    gc.disable()
    try:
        from .operators import registration
        from .operators.cli import blender_command

        registration.register()
        blender_command.register()
    finally:
        if collecting:
            gc.enable()


def unregister() -> None:
    """Take off everything that `register` added."""
    from .operators import registration
    from .operators.cli import blender_command

    blender_command.unregister()
    registration.unregister()
