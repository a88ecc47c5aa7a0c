# SPDX-License-Identifier: GPL-3.0-or-later
"""Where exported frames come from: a store seen along a camera path, or the terrains of a .blend file.

Both classes have `settings` (what all frames depend on, for a digest), `inputs` (the files of a frame) and `pieces`
(the terrains of a frame, each refined for the camera).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...cbt_terrain.attributes.attribute import GEOMETRY, AttributeRequest
from ...cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.bicubic import interpolated
from ...cbt_terrain.field.detail import Detail
from ...cbt_terrain.field.heightfield import INTERPOLATIONS, anchored, with_detail
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.importing.thinning import loaded_text
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.refine.reported_bounds import ReportedBounds
from ...cbt_terrain.scatter.points import ScatterPoints
from ...cbt_terrain.terrain import Terrain, Update
from ...cbt_terrain.view.camera_path import read_camera_path
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.settings import BOUNDS
from ...cbt_terrain.view.view import View
from ..bridge.scene_paths import absolute_path
from ..session.pauses import handlers_paused
from ..terrain.overrides import NO_OVERRIDES, Overrides
from .blend_files import check_distinct_names, file_name, new_object, open_scene
from .summaries import content_digest


@dataclass(frozen=True)
class Piece:
    """One terrain at one frame.

    Attributes:
        name: start of the names of its files.
        surface: arrays of the mesh. Those of a scene's terrain are copies, because anything in Blender may update a
            terrain; those of a store's terrain are valid until the next frame is refined.
        origin: float64 [3], metres, to which the positions are relative.
        update: the engine's, with bounds and times.
        info: facts of the frame for JSON.
        obj: the Blender object that shows it, None without Blender.
        tree: the saved tree for `Terrain.restore`; b"" of a baked mesh.
        scatters: points and their placement (float64 [4, 4]) by the name of their file.
    """

    name: str
    surface: Surface
    origin: np.ndarray
    update: Update
    info: dict
    obj: Any = None
    tree: bytes = b""
    scatters: dict[str, tuple[ScatterPoints, np.ndarray]] = field(default_factory=dict)


class StoreFrames:
    """A store seen along a camera path; needs no bpy unless a format does."""

    name, with_scatters = "terrain", False

    def __init__(
        self,
        store: Path,
        path: Path,
        criterion: Criterion,
        resolution: tuple[int, int],
        in_blender: bool,
        interpolation: str = INTERPOLATIONS[0],
        effects: Sequence[str] = (),
        detail: Detail | None = None,
        has_anchor: bool = False,
    ):
        """Open a store and a camera path; `effects`: attributes that the mesh gets, at the scale of the finest samples.

        in_blender: whether a format needs a Blender object; its empty file takes the place of the open one. detail:
        displacement, or None. has_anchor: positions are about a point near the path instead of the raster's middle.
        resolution: pixels. Raises TerrainError.
        """
        self.files = [Path(store), Path(path)]
        self.path = read_camera_path(path)
        self.criterion, self.resolution = criterion, resolution
        field, self.placement = open_store(store), None
        if has_anchor:
            x, y = (self.path.values[:, :2].min(axis=0) + self.path.values[:, :2].max(axis=0)) / 2
            field = anchored(field, *field.lattice.anchor_near(float(x), float(y)))
            self.placement = np.eye(4)
            self.placement[:2, 3] = field.lattice.anchor_x, field.lattice.anchor_y
        self.field = with_detail(interpolated(field, interpolation), detail)
        self.terrain = Terrain(self.field)
        self.effects = plan(AttributeRequest(name, readers=("the export",), family=GEOMETRY) for name in effects)
        self.obj = new_object(self.name) if in_blender else None
        self.settings = {
            "store": field_identity(self.field),
            "path": content_digest(path),
            "resolution": list(resolution),
            "criterion": asdict(criterion),
            "effects": sorted(effects),
        }

    def inputs(self, frame: int) -> list[Path]:
        """Return the files, and the folder of the store, that a frame is made of."""
        return self.files

    def pieces(self, frame: int) -> Iterator[Piece]:
        """Yield one Piece: the terrain as the path's camera sees it at `frame`, and the tree that rebuilds its mesh.

        If the store is exported from Blender, its object `obj` also gets the mesh, for Blender's exporters.
        """
        view = self.path.view(frame, self.resolution)
        update = self.terrain.update(self.criterion, [view], self.placement)
        tree, tree_settings = self.terrain.saved()
        request = EffectRequest(self.effects, update.surface)
        evaluated = evaluate(self.field, request, self.terrain.history, self.terrain.threads)
        surface = update.surface.with_attributes(evaluated.attributes)
        info = describe(update, self.criterion, [view], self.field, self.placement)
        info |= {"frame": frame, "tree": tree_settings}
        if self.obj is not None:
            from ..bridge.writer import write_mesh

            write_mesh(self.obj.data, surface)
        origin = self.field.origin  # float64, metres: positions are relative to it
        yield Piece(self.name, surface, origin=origin, update=update, info=info, obj=self.obj, tree=tree)


class SceneFrames:
    """The terrains of a .blend file, each with its render settings, refined for the file's camera at each frame.

    The file is opened, and its scene stays at the last frame. `camera` names another camera; `resolution`: pixels, None
    for the scene's; `overrides` replace settings of all objects. `with_scatters`: their points are written too.
    `stores`: folder of the stores of a farm's job, None for the terrains' own. Raises TerrainError.
    """

    def __init__(
        self,
        blend: Path,
        camera: str | None,
        resolution: tuple[int, int] | None,
        overrides: Overrides = NO_OVERRIDES,
        with_scatters: bool = False,
        stores: Path | None = None,
    ):
        """Open the file, and find the camera by its name. None keeps a setting of the scene. Raises TerrainError."""
        content = content_digest(blend)  # before Blender reads it: a later change makes the frames stale
        self.scene, self.objects = open_scene(blend, stores)

        from ..scatter.request import scatters_of

        self.name, self.with_scatters = Path(blend).stem, with_scatters
        self.resolution, self.overrides = resolution, overrides
        check_distinct_names(self.objects)
        if with_scatters:
            check_distinct_names([scatter for obj in self.objects for scatter in scatters_of(obj)])
        self.camera = None
        if camera is not None:
            local = (obj for obj in self.scene.objects if obj.name == camera and obj.library is None)
            self.camera = next(local, self.scene.objects.get(camera))  # an object of a library may have the same name
            if self.camera is None or self.camera.type != "CAMERA":
                cameras = ", ".join(sorted(o.name for o in self.scene.objects if o.type == "CAMERA")) or "none"
                raise TerrainError(
                    f"The scene {self.scene.name!r} has no camera {camera!r}; it has {cameras}", fix="choose one"
                )
        options = {"camera": camera, "resolution": resolution, "scatters": with_scatters, **overrides.to_json()}
        used = {obj.name: obj.adaptive_terrain.store for obj in self.objects}
        fields = {name: field_identity(open_store(absolute_path(path))) for name, path in used.items() if path}
        self.settings = {"scene": content, "height_fields": fields, **options}
        self.files = [Path(blend), *(Path(absolute_path(path)) for path in used.values() if path)]

    def inputs(self, frame: int) -> list[Path]:
        """Return the files, and the folders of stores, that a frame is made of."""
        from .scene_files import color_config, scene_files

        return [*self.files, *color_config(), *scene_files([frame])]

    def pieces(self, frame: int) -> Iterator[Piece]:
        """Yield a Piece of every terrain of the scene, which stays at `frame`. Its object has the mesh already."""
        import bpy

        with handlers_paused():  # an export updates each terrain once, for the render
            self.scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        for obj in self.objects:
            options = {"camera": self.camera, "resolution": self.resolution, "overrides": self.overrides}
            yield scene_piece(obj, depsgraph, frame, **options)


def scene_piece(obj, depsgraph, frame: int, **options) -> Piece:
    """Update the terrain `obj` at the detail of a render, write its mesh, and return it as a Piece.

    options: `camera`, `resolution` and `overrides` in place of those of the scene. Raises TerrainError.
    """
    from ...cbt_terrain.view.linear import determinant
    from ..bridge.cleanup import clean_up
    from ..scatter.instancing import follows_scale
    from ..scatter.request import scatters_of
    from ..session import session
    from ..terrain.request import RENDER, gather

    with session.engine_lock:  # the live update's thread would go on with the same engine
        update = session.update_object(obj, depsgraph, RENDER, **options)
        request = gather(obj, depsgraph, RENDER, **options)
        record = session.record_of(obj)
        shown = session.shown_surface(record, update)  # the update's surface with attributes
        surface = clean_up(shown, request.cleanup).copy()
        # tree: bytes from which the mesh can be rebuilt, with the settings that this needs
        heights, (tree, tree_settings) = record.field, record.terrain.saved()
        children, scatters = {child.session_uid: child for child in scatters_of(obj)}, {}
        for item in request.scatters.items:
            child = children[item.uid]
            placement = np.array(child.evaluated_get(depsgraph).matrix_world, np.float64)
            points = record.scatters[item.uid].points
            if follows_scale(child):  # of an older version, with sizes times the mean scale along the axes
                points = replace(points, size=points.size * np.float32(np.cbrt(abs(determinant(placement[:3, :3])))))
            scatters[file_name(child)] = points, placement
    info = describe(update, request.criterion, request.views, heights, request.placement)
    info |= {"frame": frame, **counts(surface), "tree": tree_settings, "frozen": bool(request.frozen)}
    return Piece(
        file_name(obj), surface, origin=heights.origin, update=update, info=info, obj=obj, tree=tree, scatters=scatters
    )


def baked_piece(
    store: Path,
    max_error_m: float,
    budget: int | None,
    in_blender: bool,
    interpolation: str,
    detail: Detail | None,
    fitted: bool,
    on_progress: Callable[[float], None],
) -> Piece:
    """Return a static mesh that is at most `max_error_m` metres of height off its store's height field.

    `budget`: largest number of triangles, None for any; it may make the error larger. `in_blender`: whether the format
    needs a Blender object, which is made in an empty file that replaces the open one. `detail`: displacement, or None.
    `fitted`: vertices leave the surface to save triangles, which `on_progress` follows (0 .. 1); the info then has the
    measured maximum.
    """
    from ...cbt_terrain.fit.fit import bake, check_interpolation

    if fitted:
        check_interpolation(interpolation)
    field = with_detail(interpolated(open_store(store), interpolation), detail)
    criterion = Criterion(error_px=0.0, error_m=max_error_m, max_triangles=budget)
    update = bake(field, max_error_m, fitted=fitted, max_triangles=budget, on_progress=on_progress)
    # No rounds: the mesh without the fit was best.
    fit_info = {"fitted": update.rounds > 0, "measured_max_m": update.worst_m} if fitted else {}
    obj = new_object(StoreFrames.name) if in_blender else None
    if obj is not None:
        from ..bridge.writer import write_mesh

        write_mesh(obj.data, update.surface)
    info = describe(update, criterion, [], field) | fit_info
    # Positions of the surface are relative to field.origin, float64 metres.
    return Piece(StoreFrames.name, update.surface, origin=field.origin, update=update, info=info, obj=obj)


def describe(update: Update, criterion: Criterion, views: list[View], field, placement=None) -> dict:
    """Return the info of a piece for JSON. It depends on the frame alone, so it has no times.

    placement: the terrain's space to the world, float64 [4, 4]; None if both are the same.
    """
    anchor = field.lattice.anchor_x, field.lattice.anchor_y
    return {
        "generator": "Adaptive Terrain",
        "units": {"positions": "m", "origin": "those of crs", "error_px": "px", "error_m": "m"},
        "asked": asdict(criterion),
        **bounds_of(update),
        "leaves": update.leaves,
        **counts(update.surface),
        "views": [_view_to_json(view) for view in views],
        "placement": np.eye(4).tolist() if placement is None else placement.tolist(),
        **({"anchor": anchor} if any(anchor) else {}),
        "crs": field.crs,
        "height_field": str(field.key),
        **loading_note(field),
        "interpolation": field.interpolation,
        # The displacement: noise by its settings, images and layers by their key, None without one.
        "detail": asdict(field.detail) if isinstance(field.detail, Detail) else field.detail and field.detail.key,
    }


def counts(surface: Surface) -> dict:
    """Return the counts of a mesh's elements for JSON."""
    return {"vertices": len(surface.positions), "edges": len(surface.edges), "triangles": len(surface.triangles)}


def bounds_of(bounds: ReportedBounds) -> dict:
    """Return the bounds of a mesh and their terms for JSON; a bound that was not requested is None.

    bounds: also an Update, which has them.
    """
    return {
        **{name: getattr(bounds, name) for name in BOUNDS},
        "terms_px": bounds.terms_px and asdict(bounds.terms_px),
        "terms_m": bounds.terms_m and asdict(bounds.terms_m),
        "relaxed": bounds.relaxed,
        "limited": bounds.limited,
    }


def loading_note(field) -> dict:
    """Return the detail to which an incomplete store is loaded, for JSON; {} for a complete one."""
    text = loaded_text(field.provenance)
    return {"loaded": text} if text else {}


def _view_to_json(view: View) -> dict:
    """Return a view as JSON values."""
    return {
        "kind": view.kind,
        "world_to_camera": view.world_to_camera.tolist(),
        "projection": None if view.projection is None else view.projection.tolist(),
        "resolution": list(view.resolution),
        "clip": list(view.clip),
    }


def field_identity(field) -> list:
    """Return the properties of a height field that an export depends on, for the summaries' digests."""
    return [str(field.key), field.origin.tolist(), field.crs]
