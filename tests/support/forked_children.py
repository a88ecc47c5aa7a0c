# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes that are forked from one process, which has imported their modules, instead of started.

Each child would import numpy, Warp and the engine for a second of a processor, and load kernels for a tenth of one:
most of the time of the tests of the operators and the engine. So do faults that kill a child at a stage of its work.
Tests of processes themselves, hard cases, other faults and the real program start real children.
"""

import atexit
import ctypes
import functools
import gc
import importlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from types import SimpleNamespace

import pytest

MODULES = (
    *("height_operators.export", "height_operators.shape_process", "importing.build_store", "importing.import_process"),
    *("importing.placing", "importing.source_info", "mosaic.import_child", "run.idle_process"),
)
KERNEL_ROOMS = "field", "land", "mosaic"  # those of an import and of shaping
BECOME_PARENT_OF_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER
MAX_REQUEST_BYTES = 100_000
_lock = threading.Lock()  # one request at a time: tests start children on threads, too


@functools.cache
def _nursery() -> socket.socket:
    """Start the process that forks; return the channel for requests. It ends with this process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ctypes.CDLL(None).prctl(BECOME_PARENT_OF_ORPHANS, 1, 0, 0, 0)
    # Without Blender's own scripts, which bpy has added: among them is another package bpy, which it alone can import.
    path = os.pathsep.join(folder for folder in sys.path if folder and "scripts" not in Path(folder).parts)
    from adaptive_terrain.cbt_terrain.run.child import FOREIGN_VARIABLES

    # As for a started child: rasterio reads PROJ_DATA, which a test may have set, when it is imported.
    environment = {k: v for k, v in os.environ.items() if k not in FOREIGN_VARIABLES} | {"PYTHONPATH": path}
    subprocess.Popen([sys.executable, "-P", __file__], stdin=theirs, env=environment, start_new_session=True)
    theirs.close()
    return ours


class ForkedChild(subprocess.Popen):
    """A child process of the extension that is forked from the nursery."""

    def _execute_child(
        self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, startup, flags, shell, *pipes_and_more
    ):
        from adaptive_terrain.cbt_terrain.run import child

        pipes = pipes_and_more[:6]
        streams = [given if given >= 0 else number for number, given in enumerate((pipes[0], pipes[3], pipes[5]))]
        _, package, module, *arguments = args[args.index(child.BOOTSTRAP) + 1 :]
        request = {"module": f"{package}.{module}", "arguments": arguments, "folder": os.getcwd(), "environment": env}
        with _lock:
            socket.send_fds(_nursery(), [json.dumps(request).encode()], streams)
            self.pid = int(_nursery().recv(MAX_REQUEST_BYTES))
        self._child_created = True
        self._close_pipe_fds(*pipes)


def start(command: list[str], **how) -> subprocess.Popen:
    """Fork a child of the extension, or start another program, as subprocess.Popen does."""
    from adaptive_terrain.cbt_terrain.run import child

    same_kernels = how["env"].get("WARP_CACHE_PATH") == os.environ.get("WARP_CACHE_PATH")
    forks = sys.platform == "linux" and child.BOOTSTRAP in command and same_kernels
    return (ForkedChild if forks else subprocess.Popen)(command, **how)


def fork(patch: pytest.MonkeyPatch) -> None:
    """Fork children of the extension from one process that has imported their modules, until the patch is undone."""
    from adaptive_terrain.cbt_terrain.run import child

    patch.setattr(child, "subprocess", SimpleNamespace(Popen=start, PIPE=subprocess.PIPE))


@pytest.fixture
def fork_children(monkeypatch):
    """Fork children of the extension."""
    fork(monkeypatch)


def _serve(channel: socket.socket) -> functools.partial:
    """Fork a child for each request; return, in the child, its work."""
    gc.disable()
    for module in MODULES:
        importlib.import_module(f"adaptive_terrain.cbt_terrain.{module}")
    importlib.import_module("rasterio.warp")  # GDAL and PROJ read their settings later
    _load_compiled_kernels()
    gc.freeze()
    while True:
        message, streams, _, _ = socket.recv_fds(channel, MAX_REQUEST_BYTES, 3)
        if not message:
            os._exit(0)
        reading, writing = os.pipe()
        # Forked twice: the process of the tests becomes the parent of the orphan.
        if between := os.fork():
            os.waitpid(between, 0)
            channel.send(os.read(reading, 100))
            for descriptor in (reading, writing, *streams):
                os.close(descriptor)
        elif orphan := os.fork():
            os.write(writing, str(orphan).encode())
            os._exit(0)
        else:
            os.setsid()
            channel.close()
            for number, descriptor in enumerate(streams):
                os.dup2(descriptor, number)
            for descriptor in (reading, writing, *streams):
                os.close(descriptor)
            return _work_of(json.loads(message))


def _load_compiled_kernels() -> None:
    """Load the kernels that are compiled already; a child compiles others when it needs them."""
    from adaptive_terrain.cbt_terrain.run import warmup

    for room in KERNEL_ROOMS:
        for module in warmup.modules_of(importlib.import_module(f"adaptive_terrain.kernels.{room}")):
            if warmup.compiled_file(module).exists():
                warmup.load(module)


def _work_of(request: dict) -> functools.partial:
    """Take the folder and the environment of a request, and return its work."""
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    tempfile.tempdir = None
    gc.enable()
    main = functools.partial(importlib.import_module(request["module"]).child_main, *request["arguments"])
    return functools.partial(_end_after, main)


def _end_after(main: functools.partial) -> None:
    """Run a child's work and end the process, without the time that Python takes to free all modules."""
    code = 1
    try:
        main()
        code = 0
    except SystemExit as exit_:
        code = exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        threading._shutdown()  # waits for threads
        atexit._run_exitfuncs()
        for stream in filter(None, (sys.stdout, sys.stderr)):  # None where a program began with it closed
            stream.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve(socket.socket(fileno=os.dup(0)))()
