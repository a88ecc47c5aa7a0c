# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes end with all processes that they have started."""

import os
import subprocess
import sys
import time

import pytest
from adaptive_terrain.cbt_terrain.run import child

pytestmark = pytest.mark.skipif(os.name != "posix", reason="process groups are those of POSIX")
# Starts a process in its group, which sleeps, and prints its number.
LEAVES_ONE = """
import os, sys, time
pid = os.fork()
if pid == 0:
    time.sleep(600)
print(pid, flush=True)
time.sleep(float(sys.argv[1]))
"""


def started(seconds: float) -> tuple[subprocess.Popen, int]:
    """Start a child that leaves a process behind. Return the child and the number of that process."""
    command = [sys.executable, "-c", LEAVES_ONE, str(seconds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
    return process, int(process.stdout.readline())


def ends(pid: int) -> bool:
    """Wait for a minute; returns whether the process has ended."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            with open(f"/proc/{pid}/stat") as file:
                if file.read().rpartition(")")[2].split()[0] == "Z":
                    return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="needs /proc")
@pytest.mark.parametrize("seconds", [0, 600])
def test_what_a_child_leaves_ends_with_it(seconds):
    process, left = started(seconds)
    if seconds:
        assert child.poll(process) is None
        child.kill(process)
    while child.poll(process) is None:
        time.sleep(0.01)
    assert ends(left)
    process.stdout.close()


def test_a_child_that_was_waited_for_has_an_exit_code():
    process = subprocess.Popen([sys.executable, "-c", "raise SystemExit(3)"], start_new_session=True)
    process.wait()
    assert child.poll(process) == 3
    child.kill(process)
