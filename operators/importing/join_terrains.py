# SPDX-License-Identifier: GPL-3.0-or-later
"""Join: several terrains become one, whose store is imported from the files of all."""

import bpy

from .. import jobs
from ..scatter.request import scatters_of
from ..session import session
from ..terrain.properties import FILE
from .add_tiles import sources_of
from .import_terrain import ImportOperator


class JoinTerrains(ImportOperator, bpy.types.Operator):
    """Import the files of all selected terrains as one, without gaps between them. The active terrain keeps its
    settings and covers the others; they are removed at the end"""

    bl_idname = "adaptive_terrain.join"
    bl_label = "Join Terrains"
    bl_options = {"REGISTER", "UNDO"}

    shows_first_picture = False  # the other terrains stay until the import is complete

    @classmethod
    def poll(cls, context):
        """Return whether several terrains from files are selected; otherwise set the reason that Blender shows."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Select several terrains whose source is a file")
        return has_file(context.object) and bool(others_of(context))

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Import the sources of all selected terrains; return report and path as ImportOperator does.

        The active terrain has all sources from the start on, and its own ones again if the import fails.
        """
        settings, others = context.object.adaptive_terrain, others_of(context)
        self.joined = [other.session_uid for other in others]
        paths = [*sources_of(settings), *(path for other in others for path in sources_of(other.adaptive_terrain))]
        self.earlier = settings.source_path, [item.path for item in settings.more_sources]
        # The last file covers the others, so those of the active terrain come last.
        first = len(sources_of(settings))
        _set_sources(settings, list(dict.fromkeys([*paths[first:], *paths[:first]])))
        try:
            return (yield from ImportOperator.steps(self, context, job))
        except BaseException:
            self._restore(job.terrain())
            raise

    def finish(self, context, obj, result: tuple[dict, str]) -> None:
        """Give the store to the active terrain, and remove the others with their meshes unless other objects use them.

        Children of the removed terrains become children of the active one. They stay in their place, except scatters,
        which get points of the joined terrain.
        """
        ImportOperator.finish(self, context, obj, result)
        for other in [other for other in session.all_terrains() if other.session_uid in self.joined]:
            mesh, scatters = other.data, scatters_of(other)
            for child in other.children:
                in_world, child.parent = child.matrix_world.copy(), obj
                if child not in scatters:
                    child.matrix_world = in_world  # a new parent would move it
            bpy.data.batch_remove([other, *([mesh] if mesh.users == 1 else [])])

    def _restore(self, obj) -> None:
        """Give a terrain the sources that it had before the job; nothing if it is gone, None."""
        if obj is not None:
            path, more = self.earlier
            _set_sources(obj.adaptive_terrain, [path, *more])


def has_file(obj) -> bool:
    """Return whether an object is a terrain whose source is a file."""
    return session.is_terrain(obj) and obj.adaptive_terrain.source == FILE and bool(obj.adaptive_terrain.source_path)


def others_of(context) -> list:
    """Return the selected terrains, besides the active one, whose source is a file, in the order of their names."""
    return sorted((o for o in context.selected_objects if o != context.object and has_file(o)), key=lambda o: o.name)


def _set_sources(settings, paths: list[str]) -> None:
    """Make `paths` the sources of a terrain: the first its file, the others further files."""
    settings.source_path = paths[0]
    settings.more_sources.clear()
    for path in paths[1:]:
        settings.more_sources.add().path = path
