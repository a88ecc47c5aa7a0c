# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of operators that compute at once, but may have to wait until their kernels are compiled."""

from types import ModuleType

from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.run import warmup
from .session.polls import remember_object, remembered_object

WAIT_S = 0.1
_waiting: set[str] = set()  # bl_idname of operators that wait: a second click would carry them out twice


class KernelOperator:
    """Base of operators that wait for kernels after a click. The window stays usable, and its status line shows the
    progress.

    A subclass has `kernels(context)`, which returns the modules that its `execute` needs. A script does not wait.

    Attributes:
        timer: the timer of the wait, None without one.
    """

    timer = None

    def kernels(self, context) -> list[ModuleType]:
        """Return the modules of kernels that the operator needs. Raises TerrainError for invalid settings."""
        raise NotImplementedError

    def invoke(self, context, event):
        """Execute the operator, or start a timer that does once the kernels are ready, unless one waits already."""
        if self.bl_idname in _waiting:
            return {"CANCELLED"}
        if self._has_kernels(context):
            return self.execute(context)
        self.start_waiting(context)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def start_waiting(self, context) -> None:
        """Start the timer that calls `modal` while the kernels are prepared."""
        remember_object(self, context)
        _waiting.add(self.bl_idname)
        self.timer = context.window_manager.event_timer_add(WAIT_S, window=context.window)

    def modal(self, context, event):
        """Execute the operator once the kernels are ready; the timer calls this until then.

        Cancel it if its object is gone or `poll` refuses it by then.
        """
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            with remembered_object(self, context):
                if can_run := self.poll(context):
                    if not self._has_kernels(context):
                        return {"PASS_THROUGH"}
                self.cancel(context)
                return self.execute(context) if can_run else {"CANCELLED"}
        except TerrainError:  # the object is gone
            self.cancel(context)
            return {"CANCELLED"}

    def cancel(self, context):
        """Stop waiting, also because another file is opened. Blender also calls this when a file dialog is cancelled:
        then nothing waits.
        """
        if self.timer is not None:
            _waiting.discard(self.bl_idname)
            context.window_manager.event_timer_remove(self.timer)

    def _has_kernels(self, context) -> bool:
        """Return whether the kernels are loaded, or the settings invalid; if not, start to prepare them."""
        if warmup.preparing():
            return False
        try:
            return warmup.prepare_modules(self.kernels(context))
        except TerrainError:
            return True  # the operator reports it
