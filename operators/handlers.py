# SPDX-License-Identifier: GPL-3.0-or-later
"""When Blender calls: frame change, render, load and undo. Each handler is persistent and keeps no Blender data.

Blender calls `render_pre` with the frame set, then `frame_change_post` with the render's dependency graph, then, for
motion blur, `frame_change_post` again at shutter times, which may be whole neighbouring frames. The mesh must keep one
topology over the shutter, so it is rebuilt for the frame of `render_pre` only, until `render_post`.
"""

import traceback
from functools import wraps

import bpy
from bpy.app.handlers import persistent

from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.run import stopping
from .accuracy import measuring
from .accuracy import report as accuracy_report
from .bridge import freed_memory, video_edits
from .bridge.applied import remember
from .bridge.demand import demand_cache
from .bridge.writing import allow_writing
from .ground import keep_ground
from .importing import import_terrain, incomplete, shared_origin
from .land import render_wait, resting_land
from .session import applied_transforms, live, pauses, session, stale_renders
from .terrain.request import RENDER, VIEWPORT
from .text.console import print_line

# A terrain's mesh and attributes depend on no other type.
SEEN_TYPES = bpy.types.Object, bpy.types.Camera, bpy.types.Scene, *demand_cache.TYPES
VIEWPORT_RENDER = "RENDER_OT_opengl"
_rendered_frames: dict[int, tuple[int, float]] = {}  # session_uid of a scene -> frame and subframe of its render_pre
_joined_frames: dict[int, tuple[int, float]] = {}  # the same of other scenes that its compositor takes in


def _unless_paused(handler):
    """Decorate a handler: do nothing during a pause (pauses.py), and let Ctrl-C wait until the handler ends.

    A change of the scene is noted in a pause, too (`_note_scene_change`), because Blender does not report it again.
    """

    @persistent
    @wraps(handler)
    def unless_paused(scene, depsgraph=None):
        """Call the handler, unless updates are paused; a request to stop waits until it returns."""
        _note_scene_change(depsgraph)
        if not pauses.is_paused():
            with stopping.held():
                handler(scene, depsgraph)

    return unless_paused


def _note_scene_change(depsgraph) -> None:
    """Drop the cached reading of the scene's materials and nodes if the change may alter it; call it in a pause, too.

    It tells which attributes the next update has to compute.
    """
    if depsgraph is not None and depsgraph.mode == VIEWPORT:
        demand_cache.note_update(depsgraph)


def update_all(scene, depsgraph, mode: str) -> list[TerrainError]:
    """Update the scene's terrains; one that fails keeps its mesh and does not stop the others. Returns the errors.

    mode: VIEWPORT or RENDER. A render needs the terrains in its dependency graph: rendered objects and their inputs,
    and those that only an instance of a collection shows. In a viewport those are updated that are live, or whose mesh
    is still that of a render. A render for a video edit is through the cameras of its strips.
    """
    failed = []
    edited = video_edits.cameras_in(_edits_of(scene), scene) if mode == RENDER else []
    options = {"scene_cameras": edited} if edited else {}
    for obj in session.all_terrains() if mode == RENDER else session.terrains_of(scene):
        if mode == RENDER and not obj.evaluated_get(depsgraph).is_evaluated:
            continue
        after_render = session.record_of(obj).status.mode == RENDER
        if mode == VIEWPORT and not (obj.adaptive_terrain.live or after_render):
            continue
        try:
            session.update_object(obj, depsgraph, mode, **options)
        except Exception as error:
            failed.append(session.as_terrain_error(error))
            if not isinstance(error, TerrainError):
                traceback.print_exc()
    return failed


def _update_viewport(scene, depsgraph) -> None:
    """Update the scene's terrains for the viewport at once, and print the errors: no operator is there to show them."""
    for error in update_all(scene, depsgraph, VIEWPORT):
        print_line(f"Adaptive Terrain: {error}")


def _mesh_is_needed_now() -> bool:
    """Return whether the mesh has to be ready when the handler returns, rather than at the next turn of the timer.

    Without a window a script reads it next; an animation that is rendered from the viewport draws it next.
    """
    if bpy.app.background:
        return True
    windows = bpy.context.window_manager.windows
    return any(running.bl_idname == VIEWPORT_RENDER for window in windows for running in window.modal_operators)


def _rendered_frame(scene) -> tuple[int, float] | None:
    """Return the frame and subframe that a scene is rendered at, None outside a render.

    Blender calls `render_pre` for the scene that the user renders. Other scenes that its compositor reads are
    rendered at the first frame that they are set to, which is recorded here.
    """
    if not _rendered_frames:
        return None
    now = scene.frame_current, scene.frame_subframe
    return _rendered_frames.get(scene.session_uid) or _joined_frames.setdefault(scene.session_uid, now)


def _edits_of(scene) -> list:
    """Return the scenes that are being rendered and whose video edit shows `scene` by a strip."""
    return video_edits.edits_of(scene, [other for other in bpy.data.scenes if other.session_uid in _rendered_frames])


@persistent
@allow_writing
def on_before_frame(scene, _unused=None) -> None:
    """Undo the moves of objects that were kept on the ground, so that their animation of the new frame applies."""
    keep_ground.release(scene)


@persistent
@allow_writing
def on_frame_change(scene, depsgraph) -> None:
    """Update objects on the ground, then terrains.

    Objects come first, also in a pause, because a terrain may be refined for a camera among them.
    """
    _note_scene_change(depsgraph)  # first: evaluating the graph again would replace its list of changes
    with stopping.held():
        failed = _settle_objects(scene, depsgraph)
        if not pauses.is_paused():
            _update_terrains(scene, depsgraph, failed)


def _settle_objects(scene, depsgraph) -> list[TerrainError]:
    """Move objects that are kept on the ground to it (keep_ground.py).

    Notes are printed. Return the error in a list, [] without one: an object that a render needs could not be placed.
    """
    # Missing ground is computed only if the frame is used when the handler returns.
    waits = depsgraph.mode == RENDER or pauses.is_paused() or _mesh_is_needed_now()
    try:
        for note in keep_ground.settle(scene, depsgraph, depsgraph.mode, waits=waits, frame_changes=True):
            print_line(f"Adaptive Terrain: {note}")
    except Exception as error:
        if not isinstance(error, TerrainError):
            traceback.print_exc()
        return [session.as_terrain_error(error)]
    return []


def _update_terrains(scene, depsgraph, failed: list[TerrainError]) -> None:
    """Update the terrains after a change of frame: for a render at its frame, for the viewport now or at the
    timer's next turn.

    At another time of a render, as of motion blur, the mesh stays. If the wait for an import was ended, no terrain is
    updated. `failed`: errors of `_settle_objects`, to which others are added. After an error the frame is stale: it
    shows meshes of another frame, and the scene's settings decide whether the render ends.
    """
    if depsgraph.mode == RENDER:
        if _rendered_frame(scene) == (scene.frame_current, scene.frame_subframe):
            terrains = session.terrains_of(scene)
            failed += incomplete.wait_for_imports(terrains, depsgraph) or update_all(scene, depsgraph, RENDER)
            if failed:
                picture = (_edits_of(scene) or [scene])[0]
                stale_renders.handle_stale_frame(scene, picture.frame_current, failed)
            incomplete.note_incomplete(scene, terrains)  # reports terrains without all their tiles
    elif _mesh_is_needed_now():
        _update_viewport(scene, depsgraph)
    else:
        live.mark_dirty()


@_unless_paused
@allow_writing
def on_render_pre(scene, _unused=None) -> None:
    """Record the frame that is to be rendered, and return freed memory to the system for the renderer.

    Terrains whose stores were replaced by another program move before the frame is evaluated.
    """
    freed_memory.give_back()  # The render needs it. Getting fresh pages later takes less time than the render.
    _rendered_frames[scene.session_uid] = scene.frame_current, scene.frame_subframe
    _joined_frames.clear()
    for obj in session.all_terrains():
        if not obj.hide_render:
            shared_origin.follow_replaced_store(obj)


@_unless_paused
def on_render_post(scene, _unused=None) -> None:
    """Forget the frame after its render, so that later frame changes are those of the viewport."""
    if not _edits_of(scene):
        stale_renders.exit_if_stopped()
    _rendered_frames.pop(scene.session_uid, None)
    _joined_frames.clear()


@_unless_paused
def on_render_end(scene, _unused=None) -> None:
    """Restore the viewport's level of detail after a render or its cancellation.

    With a window the timer does it on the main thread, where no drawing can interfere. A strip of a video edit ends
    nothing: the render of the edit goes on, and closes its movie.
    """
    if _edits_of(scene):
        _rendered_frames.pop(scene.session_uid, None)
        return
    stale_renders.exit_if_stopped()
    stale_renders.report_stale_frames()
    render_wait.forget_cancelling()
    _rendered_frames.clear()  # no scene is rendered now, nor one that a compositor takes in (`_joined_frames`)
    _joined_frames.clear()
    if not bpy.app.background:
        live.mark_dirty()
    elif scene == bpy.context.scene:  # another one is shown nowhere
        _update_viewport(scene, bpy.context.evaluated_depsgraph_get())


@_unless_paused
@allow_writing
def on_depsgraph_update(scene, depsgraph) -> None:
    """Mark the terrains for an update if an object, a camera or another type changed that they may depend on.

    A graph does not have the images of empties: Blender reports only that some image changed. A transform that was
    applied to a terrain is restored.
    """
    applied_transforms.take_back_changed(depsgraph)
    if depsgraph.id_type_updated("IMAGE") or any(isinstance(update.id, SEEN_TYPES) for update in depsgraph.updates):
        live.mark_dirty()


@_unless_paused
def on_save_pre(_path, _unused=None) -> None:
    """Complete the meshes that the file keeps: a program without the extension renders them."""
    for obj in session.all_terrains():
        session.show_normals(obj)


@_unless_paused
def on_load_pre(_path, _unused=None) -> None:
    """Stop background work and forget all terrains of the file that is about to be closed."""
    resting_land.stop()
    session.clear()


@_unless_paused
def on_load_post(_path, _unused=None) -> None:
    """Mark the terrains of the new file for an update, and remember the transforms that their meshes belong to."""
    for obj in session.all_terrains():
        remember(session.record_of(obj).placed, obj)
    live.mark_dirty()


@_unless_paused
def on_undo(_scene, _unused=None) -> None:
    """Forget all that may refer to the state before Undo or Redo, which replaces Blender's data, and update the
    terrains. Redo brings an applied transform back, which is restored again.
    """
    applied_transforms.take_back_of(session.all_terrains())
    session.forget_shown()
    measuring.stop_measurement()
    accuracy_report.remove_scratch_meshes()
    import_terrain.resume_after_undo()
    live.mark_dirty()


HANDLERS = {
    "frame_change_pre": on_before_frame,
    "frame_change_post": on_frame_change,
    "render_pre": on_render_pre,
    "render_post": on_render_post,
    "render_complete": on_render_end,
    "render_cancel": on_render_end,
    "depsgraph_update_post": on_depsgraph_update,
    "save_pre": on_save_pre,
    "load_pre": on_load_pre,
    "load_post": on_load_post,
    "undo_post": on_undo,
    "redo_post": on_undo,
}


def forget() -> None:
    """Forget which frames were rendered and joined, for another file or a test."""
    _rendered_frames.clear()
    _joined_frames.clear()
