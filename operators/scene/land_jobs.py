# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that is being shaped in child processes, for panels, for the buttons that end it, and for who would begin it."""

from dataclasses import dataclass

from ...cbt_terrain.land.shape_process import ShapeJob

LOOKING = "Looking at frames"


@dataclass
class Work:
    """Of one terrain. `job`: None while frames are looked at, or what is to be shaped is found out. `stopped`: the user
    has said so. `fraction`: 0 .. 1."""

    job: ShapeJob | None = None
    fraction: float = 0.0
    message: str = LOOKING
    stopped: bool = False

    def stop(self) -> None:
        self.stopped = True
        if self.job is not None:
            self.job.cancel()

    def poll(self):
        """The job's progress, which is noted."""
        progress = self.job.poll()
        self.fraction, self.message = progress.fraction, progress.message
        return progress


running: dict[int, Work] = {}  # by the object's session_uid


def progress_of(obj) -> tuple[float, str] | None:
    """Fraction done (0 .. 1) and what is being done, or None when the object's land is not being shaped."""
    work = running.get(obj.session_uid)
    return None if work is None else (work.fraction, work.message)


def all_progress() -> list[tuple[float, str]]:
    """The same of all that are being shaped."""
    return [(work.fraction, work.message) for work in running.values()]


def stop_all() -> None:
    for work in running.values():
        work.stop()
    running.clear()
