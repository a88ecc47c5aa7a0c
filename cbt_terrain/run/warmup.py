# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of kernels in the background, before they are needed.

Warp compiles a module of kernels at the first launch of one of them: 0.2 - 2.5 s each, about 10 s in all, and that
blocks every other thread of Python for up to 50 ms. So child processes fill Warp's cache, and a thread of this process
loads from it (60 ms in all; it blocks other threads for 8 ms at most). With a full cache there is no child. The kernels
of a frame come first. Those of the overlay and of the first buttons follow while the first terrain is already shown.
All others (detail, geomorph, occlusion, most attributes) are prepared when a scene first uses them.

The modules of kernels, and Warp, are imported by the thread as well: importing them takes 1.5 s of a processor, which a
file without a terrain does not pay. Only the first start after an installation prepares kernels without one, since
compiling them takes long.
"""

import importlib
import importlib.util
import os
import pkgutil
import subprocess
import threading
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from ..errors import TerrainError
from . import child, compile_note, launch, locks, stopping

if TYPE_CHECKING:
    import warp as wp

POLL_SECONDS = 0.1
MAX_CHILDREN = 4
HOUSE = f"{child.PACKAGE}.kernels."  # prefix of the names of all modules of kernels in this process
# Packages of kernels ("rooms"). They are imported when they are first needed: they take 1.5 s, and not every file of
# Blender has a terrain.
FRAME = "field", "tree", "refine", "budget", "mesh"
OVERLAY = ("accuracy",)
OTHERS = "effects", "land", "leb", "detail", "morph", "query", "scatter", "bicubic", "fitting", "mosaic"
RARE = {f"{HOUSE}refine.horizon_map", f"{HOUSE}refine.split_merge", f"{HOUSE}tree.edits"}  # in rooms of a frame
# Modules that Import, Set Up Scene, Add Water, Add Scatter and Drop to Ground need. After an installation the children
# compile them last, so that these buttons seldom wait. They are loaded when a scene first uses them.
FIRST_CLICKS = (
    *(f"{HOUSE}effects.{name}" for name in ("catchment", "flow", "footprint", "jet", "pyramid", "routing", "splat")),
    f"{HOUSE}land.water",
    f"{HOUSE}mosaic.resample",
    *(f"{HOUSE}scatter.{name}" for name in ("points", "seams", "squares", "tile")),
    f"{HOUSE}query.rays",
)


class _Preparation:
    """One run over groups of modules, in order of priority. Only its thread uses the child processes.

    `fraction`: 0 .. 1 while modules are compiled, else None. `ready`: one event for each group. `stopping`: event that
    ends the run.
    """

    def __init__(self, *groups: Callable[[], list[ModuleType]], later: tuple[str, ...] = ()) -> None:
        """Start the thread.

        groups: each imports and returns modules that are needed together, the most urgent group first; the thread calls
        them. later: names of modules that children, if any are needed, compile after the groups.
        """
        self.fraction: float | None = None
        self._groups, self._later, self.ready = groups, later, [threading.Event() for _ in groups]
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self._run, name="adaptive_terrain_warmup", daemon=True)
        self.thread.start()

    def _run(self) -> None:
        """Let child processes compile missing modules, load each group and set its event; runs on `thread`.

        All events are set at the end, also after a failure, so that no caller waits for ever.
        """
        from . import kernel_cache

        processes: list[subprocess.Popen] = []
        groups: list[list[ModuleType]] = []
        try:
            groups += [modules() for modules in self._groups]
            compiled = {module: compiled_file(module) for group in groups for module in group}
            if not all(file.exists() for file in compiled.values()):
                self.fraction = 0.0
                kernel_cache.ensure_writable()
                # Again, since a cache that cannot be written has been replaced by a temporary folder.
                compiled = {module: compiled_file(module) for module in compiled}
                processes = self._start_children(groups)
            for group, ready in zip(groups, self.ready, strict=True):
                self._finish(group, compiled, processes)
                ready.set()
        except Exception:  # the launch of a kernel raises it again
            traceback.print_exc()
        finally:
            self.fraction = None
            _tried.update(module for group in groups for module in group)  # `prepare_modules` does not try them again
            for ready in self.ready:
                ready.set()
            # The children go on to compile modules that are needed later: end them when they have done so, or at once
            # when the preparation is stopped.
            for process in processes:
                while process.poll() is None and not self.stopping.wait(POLL_SECONDS):
                    pass
                child.kill(process)

    def _finish(self, modules: list[ModuleType], compiled: dict[ModuleType, Path], processes: list) -> None:
        """Wait until the children have compiled `modules` or have ended, and load them.

        compiled: file of each module's compiled object. processes: the children.
        """
        files = list(compiled.values())
        while any(process.poll() is None for process in processes):
            self.fraction = sum(int(file.exists()) for file in files) / len(files)
            if all(compiled[module].exists() for module in modules) or self.stopping.wait(POLL_SECONDS):
                break
        for module in modules:
            if self.stopping.is_set():
                return
            load(module)

    def _start_children(self, groups: list[list[ModuleType]]) -> list[subprocess.Popen]:
        """Start the child processes, each with a share of every group; return none if the system allows none.

        Modules are passed by their names in the package HOUSE. Those of `_later` are compiled last, and not waited for.
        """
        from ...kernels import wp

        count = min(MAX_CHILDREN, max(1, launch.default_threads() - 1))  # one core stays with the window
        cache = {"WARP_CACHE_PATH": str(Path(wp.config.kernel_cache_dir).parent)}  # Warp appends its version
        streams = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
        names = [[module.__name__.removeprefix(HOUSE) for module in group] for group in groups]
        names.append([name.removeprefix(HOUSE) for name in self._later])
        processes = []
        try:
            for i in range(count):
                share = [name for group in names for name in group[i::count]]
                processes.append(child.start("cbt_terrain.run.warmup", *share, variables=cache, **streams))
        except OSError:
            pass  # loading compiles the rest
        return processes


# Preparations of the modules that every terrain needs, and of those that scenes of this process have requested.
_current: _Preparation | None = None
_requested: _Preparation | None = None
_tried: set[ModuleType] = set()  # modules that are not prepared again, even if loading failed


def start() -> None:
    """Start to prepare the kernels of a frame and of the overlay in the background, unless that was started before."""
    global _current
    if _current is None:
        _current = _Preparation(kernel_modules, overlay_modules, later=FIRST_CLICKS)


def is_first_start() -> bool:
    """Return whether no process has imported the kernels of this installation: Python has kept no compiled module."""
    kernels = Path(__file__).resolve().parents[2] / "kernels" / "__init__.py"
    return not os.path.exists(importlib.util.cache_from_source(str(kernels)))


def prepare_modules(modules: Iterable[ModuleType | str]) -> bool:
    """Return whether these modules are prepared. If not, start that, unless others are in progress; then call again.

    modules: modules of kernels, or names of those of this package ("effects.jet"). A module whose preparation failed
    counts as prepared: the launch of its kernels raises the error.
    """
    global _requested
    missing = [module for module in import_kernels(modules) if module not in _tried]
    if missing and not preparing():
        _requested = _Preparation(lambda: missing)
    return not missing


def stop() -> None:
    """End the preparations of `start` and `prepare_modules` at once; a `wait` in progress raises TerrainError."""
    global _current, _requested
    begun, _current, _requested = [p for p in (_current, _requested) if p is not None], None, None
    for preparation in begun:
        preparation.stopping.set()
    for preparation in begun:
        preparation.thread.join()


def _forget() -> None:
    """Forget the preparations of the parent process: their threads do not run in a forked child."""
    global _current, _requested
    _current = _requested = None


locks.in_forked_child(_forget)


def preparing() -> bool:
    """Return whether kernels are being prepared, so that an update would have to wait."""
    return any(p is not None and not p.ready[0].is_set() for p in (_current, _requested))


def progress() -> float | None:
    """Return 0 .. 1 while kernels are compiled, including those of the overlay; else None."""
    fractions = [p.fraction for p in (_current, _requested) if p is not None and p.fraction is not None]
    return fractions[-1] if fractions else None


def wait(overlay: bool = False) -> None:
    """Wait until the kernels of a frame, or of the overlay, and those of `prepare_modules` are ready.

    It returns at once if nothing was started. Raises TerrainError if `stop` is called meanwhile.
    """
    for preparation in (_current, _requested):
        if preparation is not None:
            # The first group is that of a frame, the last one that of the overlay; `prepare_modules` has a single one.
            ready = preparation.ready[-1 if overlay else 0]
            while not ready.wait(POLL_SECONDS):
                if preparation.fraction is not None:  # children compile them
                    compile_note.note()
                stopping.check()  # raises an exception if the user ends the program or cancels this work
            if preparation.stopping.is_set():
                raise TerrainError(
                    "The extension was switched off while its kernels were being prepared", fix="switch it on"
                )


def kernel_modules() -> list[ModuleType]:
    """Return every module with kernels for an import or a frame, except those in RARE."""
    return [module for module in _modules_of_rooms(FRAME) if module.__name__ not in RARE]


def overlay_modules() -> list[ModuleType]:
    """Return the modules that measure errors for the overlay."""
    return _modules_of_rooms(OVERLAY)


def other_modules() -> list[ModuleType]:
    """Return the modules of kernels that are not prepared, but compiled on first use."""
    rare = [importlib.import_module(name) for name in sorted(RARE)]
    return [*_modules_of_rooms(OTHERS), *rare]


def _modules_of_rooms(names: Iterable[str]) -> list[ModuleType]:
    """Return the modules with kernels of the rooms with these names."""
    return [module for name in names for module in modules_of(importlib.import_module(HOUSE + name))]


def modules_of(package: ModuleType) -> list[ModuleType]:
    """Return the modules of a package of kernels that define kernels themselves."""
    names = [module.name for module in pkgutil.iter_modules(package.__path__)]
    modules = [importlib.import_module(f"{package.__name__}.{name}") for name in names]
    return [module for module in modules if _kernels_of(module)]


def import_kernels(declared: Iterable[ModuleType | str]) -> list[ModuleType]:
    """Return declared modules of kernels, each once; those of this package are declared by name ("effects.jet")."""
    modules = [importlib.import_module(HOUSE + item) if isinstance(item, str) else item for item in declared]
    return list(dict.fromkeys(modules))


def _kernels_of(module: ModuleType) -> "list[wp.Kernel]":
    """Return the kernels that a module defines, without imported ones."""
    from ...kernels import wp

    kernels = [value for value in vars(module).values() if isinstance(value, wp.Kernel)]
    return [kernel for kernel in kernels if kernel.module.name == module.__name__]


def compiled_file(module: ModuleType) -> Path:
    """Return the path of a module's object; the file appears when it is complete."""
    from . import kernel_cache

    return kernel_cache.compiled_file(module.__name__)


def load(module: ModuleType) -> None:
    """Load a module's kernels, and compile them first if that has not been done."""
    for kernel in _kernels_of(module):
        launch.slices(kernel, [], step="load")  # loads the kernel and launches nothing


def child_main(*names: str) -> None:
    """Compile modules into Warp's cache; runs in a child process. names: the modules' names below the package."""
    child.end_with_parent()
    if hasattr(os, "nice"):
        os.nice(5)  # the window and an import come first
    for name in names:
        load(importlib.import_module(HOUSE + name))
