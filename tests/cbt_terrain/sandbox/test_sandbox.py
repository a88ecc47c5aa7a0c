# SPDX-License-Identifier: GPL-3.0-or-later
"""The sandbox of an import: the rights that remain, and the report of those that were dropped."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.sandbox import sandbox, system_calls
from escape_attempts import kernel_numbers

SCRIPT = Path(__file__).resolve().parents[2] / "support" / "escape_attempts.py"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a sandbox")
USERS = [0, 65534] if sys.platform == "linux" and os.getuid() == 0 else [-1]  # -1: the user of the tests


@pytest.fixture(scope="module", params=USERS, ids=str)
def escaped(request, tmp_path_factory):
    """Run the attempts; yields what they found, and the folder that they aimed at."""
    if not kernel_numbers(system_calls.platform.machine()):
        pytest.skip("the kernel's headers are not installed")
    folder = tmp_path_factory.mktemp("escape")
    for parent in (folder, folder.parent, folder.parent.parent):
        parent.chmod(0o777 if parent == folder else 0o755)
    command = [sys.executable, str(SCRIPT), str(folder), str(max(request.param, 0))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, start_new_session=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    yield found, folder
    os.kill(found["victim"], signal.SIGKILL)


def test_every_attempt_to_leave_the_sandbox_is_refused(escaped):
    found, _ = escaped
    if not all(found["report"][right] == "dropped" for right in ("network", "programs", "processes", "writes")):
        pytest.skip(f"this kernel cannot: {found['report']}")
    possible = {
        group: [name for name, reason in attempts.items() if not reason]
        for group, attempts in found["attempts"].items()
        if group != "needed_attempts"
    }
    assert possible == dict.fromkeys(possible, [])
    assert sum(len(attempts) for attempts in found["attempts"].values()) > 130


def test_an_import_can_do_what_it_needs_in_the_sandbox(escaped):
    assert set(escaped[0]["attempts"]["needed_attempts"].values()) == {""}


def test_nothing_beside_the_store_has_changed(escaped):
    found, folder = escaped
    if found["report"]["writes"] != "dropped":
        pytest.skip(found["report"]["writes"])
    assert sorted(path.name for path in folder.iterdir()) == ["empty", "pipe", "service", "store", "victim.txt"]
    assert (folder / "victim.txt").read_text() == "precious"
    assert sorted(path.name for path in (folder / "store").iterdir()) == ["link", "out", "own", "thread"]
    os.kill(found["victim"], 0)  # it still runs


@pytest.mark.parametrize("machine", system_calls.MACHINES)
def test_numbers_of_calls_are_those_of_the_kernels_headers(machine):
    numbers = kernel_numbers(machine)
    if not numbers:
        pytest.skip(f"the kernel's headers for {machine} are not installed")
    column = system_calls.MACHINES[machine][1]
    own = {name: both[column] for name, both in system_calls.ALLOWED.items()}
    assert own == {name: numbers.get(name) for name in own}


ENTER = """
import json, sys
from adaptive_terrain.cbt_terrain.sandbox import sandbox, system_calls
{change}
print(json.dumps(sandbox.enter(None) | {{"memory": sandbox.limit_memory(1 << 40)}}))
"""


def entered(change: str) -> dict[str, str]:
    """Return the report of a new process that enters the sandbox after a change."""
    done = subprocess.run([sys.executable, "-c", ENTER.format(change=change)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_other_systems_drop_nothing_and_report_it():
    report = entered("sandbox.sys.platform = 'darwin'")
    assert report.pop("memory") == "kept: only Linux can limit it"
    assert set(report.values()) == {"kept: only 64-bit Linux can drop it"}


def test_an_old_kernel_drops_nothing_and_reports_it():
    old = "def refuse(*_): raise OSError(38, 'Function not implemented')"
    report = entered(f"{old}\nsandbox.call = system_calls.call = refuse")
    assert report.pop("memory").endswith("GB at most")
    assert set(report.values()) == {"kept: this kernel refuses (Function not implemented)"}


def test_an_unknown_processor_keeps_its_calls_and_reports_it():
    report = entered("sandbox.platform.machine = lambda: 'riscv64'")
    assert report["network"] == report["processes"] == "kept: not known how on riscv64"


def test_an_older_landlock_gets_only_the_rights_it_knows():
    """Compare with the kernel's documentation: a kernel refuses a ruleset with a bit that it does not know."""
    asked, version = [], 0

    def call(_libc, number, *arguments):
        if number == sandbox.LANDLOCK_CREATE_RULESET and arguments[0] is None:
            return version
        if number == sandbox.LANDLOCK_CREATE_RULESET:
            asked.append(arguments[0])
            return os.open(os.devnull, os.O_RDONLY)
        return 0

    known = {2: [0x3FFF], 3: [0x7FFF], 4: [0x7FFF, 3], 5: [0xFFFF, 3], 6: [0xFFFF, 3, 3], 7: [0xFFFF, 3, 3]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sandbox, "call", call)
        for version in known:  # noqa: B007 - `call` reads it
            sandbox._drop_writes(None, None)
    for handled, words in zip(asked, known.values(), strict=True):
        found = memoryview(handled).cast("Q").tolist()
        assert len(found) == len(words)
        assert all(have & ~may == 0 for have, may in zip(found, words, strict=True))
        assert found[1:] == words[1:]


def test_threads_that_started_before_are_reported():
    start = "import threading, time; threading.Thread(target=time.sleep, args=(9,), daemon=True).start()"
    report = entered(start)
    assert report["writes"].startswith("kept: ")
