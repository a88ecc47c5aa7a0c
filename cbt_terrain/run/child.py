# SPDX-License-Identifier: GPL-3.0-or-later
"""Python processes beside this one, which can neither block it nor hurt it."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from . import stopping

# The child loads the package from its folder and by the name that it has in this process (`bl_ext....` in Blender):
# Warp's cache knows a kernel by the name of its module. What imports make stays: looking through it for garbage, again
# and again, takes 0.1 s.
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
# A GDAL or PROJ database of the host does not fit the child's own library.
FOREIGN_VARIABLES = ("GDAL_DATA", "GDAL_DRIVER_PATH", "PROJ_LIB", "PROJ_DATA", "PYTHONHOME", "PYTHONSTARTUP")


def start(module: str, *arguments: str, variables: dict[str, str] | None = None, **streams) -> subprocess.Popen:
    """A process that runs `child_main(*arguments)` of a module of this package ("cbt_terrain.run.warmup"), with
    `variables` added to its environment and its standard streams as Popen takes them, but for a pipe to its standard
    input, which lives as long as its parent. Ctrl-C reaches the parent alone. Raises OSError if none can be started."""
    environment = {k: v for k, v in os.environ.items() if k not in FOREIGN_VARIABLES}
    environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
    folder = Path(__file__).resolve().parents[2]
    return subprocess.Popen(
        [sys.executable, "-P", "-c", BOOTSTRAP, str(folder), PACKAGE, module, *arguments],
        env=environment | (variables or {}),
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        start_new_session=True,
        stdin=subprocess.PIPE,
        **streams,
    )


def poll(process: subprocess.Popen) -> int | None:
    """Return a child's exit code, None while it runs. What it has left of its process group ends with it."""
    if process.returncode is None and hasattr(os, "waitid"):
        with suppress(ChildProcessError):  # where SIGCHLD is ignored
            if os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
                return None
            _kill_group(process)  # before the child is reaped: until then no other group can have its number
    return process.poll()


def kill(process: subprocess.Popen) -> None:
    """End a child and its process group at once, and wait for its end."""
    if poll(process) is None:
        _kill_group(process)
        process.kill()
        process.wait()


def _kill_group(process: subprocess.Popen) -> None:
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)  # `start` has made it the leader of a session


def end_with_parent(clean_up: Callable[[], None] = lambda: None, heard: Callable[[], None] = lambda: None) -> None:
    """In the child: from now on, when the parent ends, however it does, `Stopped` is raised where `stopping.check` is
    called; if that has not ended this process after a while, it cleans up and ends. `heard` is called, on another
    thread, when the parent writes anything."""

    def wait() -> None:
        while os.read(0, 1024):
            heard()
        stopping.ask(signal.SIGTERM)
        time.sleep(stopping.GRACE_SECONDS)
        clean_up()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
