# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of tests in processes of their own, forked from one that has imported the engine (see forked_children.py).

A start of Python with numpy, Warp and the engine would take a second of a processor.
"""

import os
import subprocess
import sys

from forked_children import ForkedChild

COMMAND_LINE = "from adaptive_terrain.operators.cli.command_line import program; program()"


def start_program(source: str, *words, **streams) -> subprocess.Popen:
    """Start a process that runs the source, whose sys.argv[1:] are the words, as `python -c` would.

    streams: `stdin`, `stdout`, `stderr` and `text` of Popen.
    """
    if sys.platform != "linux":
        return subprocess.Popen([sys.executable, "-c", source, *map(str, words)], **streams)
    from adaptive_terrain.cbt_terrain.run import child

    module = child.BOOTSTRAP, "", "support", "forked_programs"  # tests is in sys.path, of the forking process, too
    return ForkedChild([*module, source, *map(str, words)], env=dict(os.environ), **streams)


def run_program(source: str, *words, timeout: float = 300.0) -> subprocess.CompletedProcess:
    """Run the source to its end, as subprocess.run with `capture_output` and `text`; `timeout` only ends a hang."""
    process = start_program(source, *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        stdout, stderr = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)


def child_main(source: str, *words: str) -> None:
    """Run the source in the forked process."""
    sys.argv = ["-c", *words]
    sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", buffering=1, closefd=False)
    exec(source, {"__name__": "__main__"})
