# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape the land in a child process: Blender stays usable, and the mesh shows the result when it is there."""

from collections.abc import Container
from contextlib import suppress
from dataclasses import replace

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators import derived_store, requested_tiles
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.height_operators.requested_tiles import SeenTiles
from ...cbt_terrain.view.view import View
from .. import jobs
from ..bridge.evaluated import raster_placement_of
from ..bridge.writing import allow_writing
from ..job_operator import JobOperator
from ..session import live, session
from ..session.shot import frames_of, visit_views
from . import resting_land
from .request import land_of


def wanted_land(obj, depsgraph, views: list[View] = ()) -> Land:
    """Return the land that Shape Now has to make: everywhere, or only the tiles that `views` see.

    views: of a terrain whose origin is the raster's middle, at its present transform; without any, all of the land is
    fine. They count only if the terrain's Detail is In the Shot (`of_views`). Raises TerrainError if the stack is
    empty, switched off or invalid.
    """
    evaluated = obj.evaluated_get(depsgraph)
    land = land_of(obj, evaluated, depsgraph, waits=True)
    if land is not None and land.of_views and views:
        settings = evaluated.adaptive_terrain
        seen = SeenTiles(
            tuple(views),
            placement=raster_placement_of(evaluated),
            error_px=settings.render.error_px,
            vertical_scale=settings.vertical_scale,
            vertical_offset=settings.vertical_offset,
        )
        land = replace(land, seen=seen)
    if land is None:
        raise TerrainError(
            f"The terrain {obj.name!r} has nothing to shape: its stack is empty or switched off", fix="add an operator"
        )
    return land


def check_is_shaped(obj, depsgraph) -> None:
    """Raise TerrainError if a terrain's stack has no shaped store yet: shaping it for a button would block the window.

    Nothing is raised without a stack, nor for a store that is fine only where earlier shots looked.
    """
    land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if land is not None and not land.is_shaped:
        raise TerrainError(
            f"The land of {obj.name!r} is not shaped at all its levels yet",
            fix="press Shape Now in the panel Land first, which runs beside the window",
        )


class ShapedLandJob(JobOperator):
    """Base of jobs on the shaped land of a terrain in Object Mode."""

    shows_error_on_panel = False
    needs_object_mode = True

    def invoke(self, context, event):
        """Start the job, or refuse land that is not shaped yet: its shaping has its own job."""
        try:
            check_is_shaped(context.object, context.evaluated_depsgraph_get())
        except TerrainError as error:
            return self.fail(context.object, str(error))
        return JobOperator.invoke(self, context, event)


def _check_is_visible(obj, depsgraph) -> None:
    """Raise TerrainError for a terrain that is hidden in viewports and renders, which is never shaped."""
    if obj.hide_render and not obj.visible_get(view_layer=depsgraph.view_layer):
        raise TerrainError(
            f"The terrain {obj.name!r} is hidden in viewports and in renders, and is not shaped", fix="show it"
        )


def _visit_views(obj, scene, land: Land, frames: list[int]):
    """Step through frames if only visible land is to be fine: yield the fraction done, and last the list of all views.

    Otherwise yield an empty list alone.
    """
    if not land.of_views:
        yield []
        return
    # about_middle: the terrain's origin is the raster's middle, as `wanted_land` expects.
    yield from visit_views(obj, scene, frames, raster_placement_of(obj), about_middle=True)


def next_unshaped(context, done: Container[str] = ()):
    """Return the first terrain whose land may have to be shaped before a render, None if there is none.

    Its land is not shaped yet, or is shaped only in the parts that cameras see (`of_views`). Tiles for the next render
    may be missing in the second case; to find out would take too long here. Terrains hidden in renders are left out.
    done: names of other terrains to leave out.
    """
    depsgraph = context.evaluated_depsgraph_get()
    for obj in session.terrains_of(context.scene):
        with suppress(TerrainError):  # the render reports it
            # waits=True: the render waits for shaped land, a preview is not enough
            land = None if obj.hide_render else land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
            if land is not None and obj.name not in done and (land.of_views or not land.is_shaped):
                return obj
    return None


class _Shaping(JobOperator):
    """Base of the operators that shape the land of `subject`."""

    kind = jobs.SHAPE

    def frames(self, scene) -> list[int]:
        """Return the frames whose views are to be fine."""
        return frames_of(scene)

    def needs_shaping(self, land: Land, wanted: requested_tiles.Tiles | None) -> bool:
        """Return whether land has to be shaped; Shape Now always shapes. wanted: its tiles, None for all.

        It is called on the main thread, after damaged land was removed.
        """
        return True

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Shape the land of the frames in a child process: the steps of a background job, which returns the land."""
        obj, scene, depsgraph = self.subject(context), context.scene, context.evaluated_depsgraph_get()
        _check_is_visible(obj, depsgraph)
        # This first land tells only whether views count; their tiles are known after the frames were visited.
        visits = _visit_views(obj, scene, wanted_land(obj, depsgraph), self.frames(scene))
        views = yield from jobs.visit_frames(job, visits)
        land = wanted_land(job.terrain(), bpy.context.evaluated_depsgraph_get(), views)
        job.progress(0.0, resting_land.CHOOSING if land.seen else "")
        wanted = yield from jobs.run_on_thread(job, lambda: derived_store.wanted_tiles(land, session.open_field))
        derived_store.is_usable(land, session.open_field)  # removes damaged land
        if not self.needs_shaping(land, wanted):
            return land
        child, wanted = derived_store.begin_shaping(land, wanted)
        derived_store.counts["stores"] += 1  # for tests
        yield from jobs.run_in_child(job, child)
        yield from jobs.wait_with_result(job)  # until the kernels are compiled that an update of the mesh may need
        derived_store.finish_shaping(land, wanted)
        return land

    def finish(self, _context, obj, _land: Land | None = None) -> None:
        """Show the land: the next update finds the shaped store by the settings."""
        try:
            live.show_soon(obj)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))


class ShapeLand(_Shaping, bpy.types.Operator):
    """Compute the land in full detail with all effects of the list. You can go on working meanwhile; a render waits for
    it"""

    bl_idname = "adaptive_terrain.shape"
    bl_label = "Shape Now"
    bl_options = {"REGISTER"}

    def stops_on_escape(self) -> bool:
        """Return whether Esc cancels: only while the scene's frames are visited, not while a child process shapes."""
        return self.job.child is None  # the scene's frames are being visited

    def execute(self, context):
        """Shape the land at once, without a child process or a progress bar: a script waits for it."""
        obj, scene = context.object, context.scene
        try:
            _check_is_visible(obj, context.evaluated_depsgraph_get())
            # As in `steps`, the first land tells only whether views count.
            *_, views = _visit_views(
                obj, scene, wanted_land(obj, context.evaluated_depsgraph_get()), self.frames(scene)
            )
            land = wanted_land(obj, context.evaluated_depsgraph_get(), views)
            derived_store.field_of_land(land, session.open_field)  # shapes it
        except TerrainError as error:
            return self.fail(obj, str(error))
        self.finish(context, obj)
        return {"FINISHED"}


class ShapeAndRender(_Shaping, bpy.types.Operator):
    """Shape the land that a render needs, then render. Esc cancels; finished parts are kept"""

    bl_idname = "adaptive_terrain.shape_and_render"
    bl_label = "Shape and Render"

    animation: bpy.props.BoolProperty(name="Animation", description="Render all frames", options={"SKIP_SAVE"})
    done: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # names of terrains, a line each

    @classmethod
    def poll(cls, context):
        """Return whether a terrain has to be shaped before a render, in Object Mode; if not, set the reason."""
        cls.poll_message_set("The land is shaped: render as usual")
        return context.mode == "OBJECT" and next_unshaped(context) is not None

    def invoke(self, context, event):
        """End the background refinement of land (resting_land.py), since this job shapes it, and start the job."""
        resting_land.give_way()
        return JobOperator.invoke(self, context, event)

    def subject(self, context):
        """Return the next terrain whose land is not shaped yet; `done` lists the names of those that are."""
        return next_unshaped(context, self.done.splitlines())

    def needs_shaping(self, land: Land, wanted: requested_tiles.Tiles | None) -> bool:
        """Return whether tiles are missing; land that was finished early is rendered as it is."""
        return not derived_store.has_tiles(land, wanted, session.open_field)

    def frames(self, scene) -> list[int]:
        """Return the frames that will be rendered, whose views decide which tiles are shaped."""
        return frames_of(scene) if self.animation else [scene.frame_current]

    def stops_on_escape(self) -> bool:
        """Return True: Esc cancels the job at any time."""
        return True

    def finish(self, context, obj, land: Land | None = None) -> None:
        """Go on with the next terrain, or render."""
        _Shaping.finish(self, context, obj, land)
        window, done, options = context.window, f"{self.done}\n{obj.name}", {"animation": self.animation}
        operator = bpy.ops.render.render
        if next_unshaped(context, done.splitlines()) is not None:
            operator, options = bpy.ops.adaptive_terrain.shape_and_render, options | {"done": done}

        @allow_writing
        def go_on() -> None:
            """Render, or shape the next terrain and then render."""
            with bpy.context.temp_override(window=window):
                operator("INVOKE_DEFAULT", **options)

        bpy.app.timers.register(go_on, first_interval=0.0)  # this job has ended by then


class FinishShaping(bpy.types.Operator):
    """Stop here and use the detail that is finished"""

    bl_idname = "adaptive_terrain.shape_finish"
    bl_label = "Finish Early"

    @classmethod
    def poll(cls, context):
        """Return whether a child process shapes the active terrain's land now."""
        job = jobs.find(jobs.SHAPE, context.object) if context.object is not None else None
        return job is not None and job.child is not None

    def execute(self, context):
        """Let the child process stop after its present level; the finished levels become the land."""
        jobs.find(jobs.SHAPE, context.object).child.finish_early()
        return {"FINISHED"}
