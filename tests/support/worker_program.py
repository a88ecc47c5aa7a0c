# SPDX-License-Identifier: GPL-3.0-or-later
"""A program that stands for Blender in jobs: each start is a fork of one process, which has imported all modules.

Without it each task of a job would import bpy and the extension for three seconds of a processor. The program is a
script that sends its arguments, environment, folder and streams to that process, and ends with the exit code of the
fork. `worker_program.py SOCKET SETUP` is the process that forks: the text SETUP defines `work(arguments)`.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MAX_REQUEST_BYTES = 1_000_000
CLIENT = """#!{python} -IS
import json, os, socket, sys
channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
channel.connect({address!r})
request = json.dumps([sys.argv[1:], dict(os.environ), os.getcwd()]).encode()
socket.send_fds(channel, [request], [0, 1, 2])
os._exit(int(channel.recv(100) or 70))
"""


@contextmanager
def worker_program(path: Path, setup: str) -> Iterator[Path]:
    """Write the program to `path` and run its process for the time of the block; yield `path`.

    setup: Python text that defines `work(arguments)`, which runs in a fork and returns the exit code.
    """
    with tempfile.TemporaryDirectory(prefix="worker") as folder:  # a socket's address has at most 107 bytes
        address = f"{folder}/requests"
        path.write_text(CLIENT.format(python=sys.executable, address=address))
        path.chmod(0o755)
        command = [sys.executable, "-P", __file__, address, setup]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        process = subprocess.Popen(command, start_new_session=True, **pipes)
        try:
            assert process.stdout.readline() == b"ready\n"
            yield path
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def _serve(address: str, setup: str) -> None:
    """Run the text, then fork for each request; the fork waits for another, which works."""
    definitions: dict = {}
    exec(setup, definitions)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(address)
    listener.listen()
    os.write(1, b"ready\n")
    while True:
        channel, _ = listener.accept()
        if os.fork() == 0:
            message, streams, _, _ = socket.recv_fds(channel, MAX_REQUEST_BYTES, 3)
            worker = os.fork()
            if worker == 0:
                _work(definitions["work"], *json.loads(message), streams)
            for descriptor in streams:
                os.close(descriptor)
            code = os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1])
            channel.send(str(code if code >= 0 else 128 - code).encode())
            os._exit(0)
        channel.close()
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def _work(work, arguments: list[str], environment: dict[str, str], folder: str, streams: list[int]) -> None:
    """Work with the streams, folder and environment of a request, and end this process."""
    code = 1
    try:
        for number, descriptor in enumerate(streams):
            os.dup2(descriptor, number)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        tempfile.tempdir = None
        code = work(arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve(*sys.argv[1:])
