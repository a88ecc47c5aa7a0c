# SPDX-License-Identifier: GPL-3.0-or-later
"""Run programs of tests in separate processes, which are forked from one with the engine (see forked_children.py).

A start of Python with numpy, Warp and the engine would take a second of a processor.
"""

import json
import os
import subprocess
import sys

from forked_children import ForkedChild

COMMAND_LINE = "from adaptive_terrain.operators.cli.command_line import program; program()"


def start_program(
    source: str, *words, closed: tuple[int, ...] = (), encoding: str = "utf-8", **streams
) -> subprocess.Popen:
    """Start a process that runs the source, whose sys.argv[1:] are the words, as `python -c` would.

    closed: standard descriptors that it lacks. encoding: of the standard streams, which Python opens at its start.
    streams: `stdin`, `stdout`, `stderr` and `text` of Popen.
    """
    words = [str(word) for word in words]
    if sys.platform != "linux":
        assert not closed
        return subprocess.Popen([sys.executable, "-c", source, *words], **streams)
    from adaptive_terrain.cbt_terrain.run import child

    module = child.BOOTSTRAP, "", "support", "forked_programs"  # tests is in sys.path, of the forking process, too
    return ForkedChild([*module, source, json.dumps([closed, encoding]), *words], env=dict(os.environ), **streams)


def run_program(
    source: str, *words, timeout: float = 300.0, stdout: int = subprocess.PIPE, **started
) -> subprocess.CompletedProcess:
    """Run the source to its end, as subprocess.run with `stderr=PIPE` and `text`; `timeout` only ends a hang.

    started: `closed` and `encoding` of start_program.
    """
    process = start_program(source, *words, stdout=stdout, stderr=subprocess.PIPE, text=True, **started)
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def child_main(source: str, how: str, *words: str) -> None:
    """Run the source in the forked process. how: JSON, the closed descriptors and the encoding of the streams."""
    sys.argv = ["-c", *words]
    _open_streams(*json.loads(how))
    exec(source, {"__name__": "__main__"})


def _open_streams(closed: list[int], encoding: str) -> None:
    """Close standard descriptors, and open the others as Python does at its start: None for one that is closed."""
    for number, (name, mode, errors) in enumerate(
        (("stdin", "r", "strict"), ("stdout", "w", "strict"), ("stderr", "w", "backslashreplace"))
    ):
        stream = None
        if number in closed:
            os.close(number)
        else:
            buffering = 1 if number == 2 else -1
            stream = open(number, mode, buffering, encoding, errors, closefd=False)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
