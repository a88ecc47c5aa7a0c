# SPDX-License-Identifier: GPL-3.0-or-later
"""Python child processes, which can neither block this process nor crash it."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from . import stopping

# The child loads the package from its folder with its name in this process (`bl_ext....` in Blender), because Warp's
# cache identifies kernels by the names of their modules. Garbage collection would take 0.1 s during the imports.
BOOTSTRAP = """
import gc, importlib, importlib.util, sys, types
gc.disable()
folder, package, module = sys.argv[1:4]
outer = package.rpartition(".")[0]
while outer:
    sys.modules[outer] = types.ModuleType(outer)
    outer = outer.rpartition(".")[0]
spec = importlib.util.spec_from_file_location(package, folder + "/__init__.py", submodule_search_locations=[folder])
sys.modules[package] = root = importlib.util.module_from_spec(spec)
spec.loader.exec_module(root)
main = importlib.import_module(package + "." + module).child_main
gc.enable()
main(*sys.argv[4:])
"""
PACKAGE = __package__.rsplit(".", 2)[0]
# The host's GDAL or PROJ database does not match the child's library.
FOREIGN_VARIABLES = ("GDAL_DATA", "GDAL_DRIVER_PATH", "PROJ_LIB", "PROJ_DATA", "PYTHONHOME", "PYTHONSTARTUP")
# The child's variable with the folders of the user's PROJ, which may hold grids.
GRID_FOLDERS = "ADAPTIVE_TERRAIN_PROJ_GRIDS"


def start(module: str, *arguments: str, variables: dict[str, str] | None = None, **streams: Any) -> subprocess.Popen:
    """Start a process that runs `child_main(*arguments)` of a module of this package ("cbt_terrain.run.warmup").

    Its standard input is a pipe that lives as long as its parent. Only the parent receives Ctrl-C. Raises OSError if no
    process can be started.

    Args:
        variables: additions to its environment.
        streams: arguments of Popen, such as stdout and stderr, or `start_new_session`.
    """
    paths = {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-P", "-c", BOOTSTRAP, *bootstrap_arguments(module, *arguments)]
    return start_program(command, paths | (variables or {}), **streams)


def bootstrap_arguments(module: str, *arguments: str) -> list[str]:
    """Return the command-line arguments that BOOTSTRAP reads."""
    return [str(Path(__file__).resolve().parents[2]), PACKAGE, module, *arguments]


def start_program(command: list[str], variables: dict[str, str] | None = None, **streams: Any) -> subprocess.Popen:
    """Start a program whose standard input is a pipe that lives as long as its parent. Only the parent receives Ctrl-C.

    It gets no settings of the host's GDAL, PROJ and Python, which may not match its libraries, but in GRID_FOLDERS the
    folders of PROJ's data, which may hold the user's grids. variables: additions to its environment. streams: arguments
    of Popen, such as stdout and stderr. Raises OSError if it cannot be started.
    """
    environment = {k: v for k, v in os.environ.items() if k not in FOREIGN_VARIABLES}
    folders = map(os.environ.get, (GRID_FOLDERS, "PROJ_DATA", "PROJ_LIB"))  # only in a child the first is set already
    environment[GRID_FOLDERS] = os.pathsep.join(filter(None, folders))
    return subprocess.Popen(
        command,
        env=environment | (variables or {}),
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        stdin=subprocess.PIPE,
        **{"start_new_session": True, **streams},
    )


def poll(process: subprocess.Popen) -> int | None:
    """Return a child's exit code, None while it runs. When it has ended, the rest of its process group is killed."""
    if process.returncode is None and hasattr(os, "waitid"):
        with suppress(ChildProcessError):  # SIGCHLD is ignored
            if os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
                return None
            _kill_group(process)  # before the child is reaped, because then another group may get its number
    return process.poll()


def kill(process: subprocess.Popen) -> None:
    """Kill a child and its process group at once, and wait for its end."""
    if poll(process) is None:
        _kill_group(process)
        process.kill()
        process.wait()


def _kill_group(process: subprocess.Popen) -> None:
    """Kill a child process and all processes that it has started."""
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)  # the child is the leader of a session: see `start`


def end_with_parent(clean_up: Callable[[], None] = lambda: None, heard: Callable[[], None] = lambda: None) -> None:
    """Stop this child process when its parent ends for any reason.

    The next `stopping.check` then raises `Stopped`. If the process still runs after GRACE_SECONDS, it calls `clean_up`
    and exits with the code 1. `heard` is called, on another thread, when the parent writes anything. From now on that
    thread alone reads stdin.
    """

    def wait() -> None:
        """Read the pipe from the parent until it closes, ask to stop, and exit after the time of grace."""
        while os.read(0, 1024):
            heard()
        stopping.request_stop(signal.SIGTERM)
        time.sleep(stopping.GRACE_SECONDS)
        clean_up()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
