# SPDX-License-Identifier: GPL-3.0-or-later
"""The real program with a window on a screen that is a file."""

import os
import struct
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image
from real_program import PATHS

SCREEN = 1600, 1000
# x, y, width and height. A window is drawn by software, which is most of its time: one of all the screen takes twice.
WHOLE, HALF = (0, 0, *SCREEN), (0, 0, 1120, 700)
# Only so that a hang ends.
GUARD_S = 1200
# Where events are simulated Blender does not sleep between them, and takes a core for as long as it is open: this gives
# back the 5 ms that it sleeps else.
RESTS = "import bpy, time; bpy.app.timers.register(lambda: time.sleep(0.005) or 0.0, persistent=True)"


@contextmanager
def window(program, arguments: list, framebuffer: Path, kernels: Path | None = None, place: tuple = HALF):
    """Start the program with a window on a screen that is a file, for scripts that simulate events; end both.

    `kernels`: folder of compiled kernels instead of the program's. `place`: x, y, width and height of the window.
    """
    display = f":{os.getpid() % 40000 + 200}"
    environment = {**program.environment(), "DISPLAY": display}
    environment |= {"WARP_CACHE_PATH": str(kernels)} if kernels else {}
    screen = ["Xvfb", display, "-nocursor", "-fbdir", str(framebuffer), "-screen", "0", f"{SCREEN[0]}x{SCREEN[1]}x24"]
    xvfb = subprocess.Popen([program.wrapper, *screen, "+extension", "GLX", "-nolisten", "tcp"], env=environment)
    blender = None
    try:
        socket = Path(f"/tmp/.X11-unix/X{display[1:]}")
        wait_for(socket, xvfb)
        log = open(framebuffer / "blender.log", "w")
        opened = ["--enable-event-simulate", "--window-geometry", *place, "--python-expr", f"{PATHS}; {RESTS}"]
        command = program.command(*opened, *arguments)
        blender = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        yield blender
    finally:
        for process in (blender, xvfb):
            if process is not None:
                process.terminate()
                process.wait(GUARD_S)


def wait_for(path: Path, process, ended: Path | None = None) -> None:
    """Wait until a file is there, or `ended`, which a script writes when it is done or has failed."""
    end = time.monotonic() + GUARD_S
    while not path.exists() and not (ended is not None and ended.exists()):
        assert process.poll() is None, f"the program ended with {process.returncode} before {path.name} was there"
        assert time.monotonic() < end, f"{path.name} was not there after {GUARD_S} s"
        time.sleep(0.1)


def read_screen(framebuffer: Path) -> Image.Image:
    """Read Xvfb's frame buffer: an X window dump with a big-endian header that states its size."""
    data = (framebuffer / "Xvfb_screen0").read_bytes()
    header = struct.unpack(">25I", data[:100])
    header_size, width, height, bytes_per_line, colours = header[0], header[4], header[5], header[12], header[19]
    start = header_size + 12 * colours
    pixels = np.frombuffer(data, np.uint8, bytes_per_line * height, start).reshape(height, bytes_per_line)
    return Image.fromarray(pixels[:, : 4 * width].reshape(height, width, 4)[:, :, 2::-1].copy())
