# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that is held between one mesh and the next: page faults, and when it is given back."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("bpy")

from adaptive_terrain.operators import freed_memory, session  # noqa: E402

SCRIPT = """
import json, sys
sys.path.insert(0, sys.argv[1])
import freed
from adaptive_terrain.operators import freed_memory
print(json.dumps(freed.measured(freed_memory)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the allocators of other systems are left alone")
def test_freed_pages_are_held_and_given_back():
    command = [sys.executable, "-c", SCRIPT, str(Path(__file__).parents[1])]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert max(found["held"], found["again"]) < 0.1 * found["before"], found
    assert found["after"] > 0.5 * found["before"] > 100, found


@pytest.mark.skipif(sys.platform != "linux", reason="the allocators of other systems are left alone")
def test_a_live_mesh_holds_freed_memory_and_a_render_gives_it_back(scene, add_terrain, monkeypatch):
    monkeypatch.setattr(freed_memory, "LARGE", 1)
    terrain = add_terrain()
    freed_memory.let_go()
    session.update_object(terrain)
    assert freed_memory._let_go is not None
    session.update_object(terrain, mode="RENDER")
    assert freed_memory._let_go is None


def test_memory_is_given_back_when_no_mesh_came_for_a_while(monkeypatch):
    given_back = []
    monkeypatch.setattr(freed_memory, "_hold_jemalloc", lambda: None)
    monkeypatch.setattr(freed_memory, "_hold_glibc", lambda: lambda: given_back.append(True))
    now = 100.0
    monkeypatch.setattr(freed_memory.time, "monotonic", lambda: now)
    freed_memory.let_go()
    freed_memory.hold()
    now += 3.0
    freed_memory.hold()
    now += 3.0
    assert freed_memory._tick() == pytest.approx(freed_memory.IDLE_S - 3.0) and not given_back
    now += 3.0
    assert freed_memory._tick() is None and given_back == [True]
    freed_memory.let_go()
    assert given_back == [True]
