# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory held between meshes: page faults, and when it is given back."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("bpy")

from adaptive_terrain.operators import handlers
from adaptive_terrain.operators.bridge import freed_memory
from adaptive_terrain.operators.session import session  # noqa: E402

SCRIPT = """
import json, sys
sys.path.insert(0, sys.argv[1])
import freed
from adaptive_terrain.operators.bridge import freed_memory
print(json.dumps(freed.measured(freed_memory)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the allocators of other systems are left alone")
def test_freed_pages_are_held_and_given_back():
    command = [sys.executable, "-c", SCRIPT, str(Path(__file__).parents[2] / "support")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert max(found["held"], found["again"]) < 0.1 * found["before"], found
    assert found["after"] > 0.5 * found["before"] > 10, found


def held() -> bool:
    return bool(freed_memory._decays) or freed_memory._glibc_holds


@pytest.mark.skipif(sys.platform != "linux", reason="the allocators of other systems are left alone")
def test_live_meshes_hold_freed_memory_until_a_render(scene, add_terrain, monkeypatch):
    freed_memory.give_back()
    terrain = add_terrain()
    session.update_object(terrain)
    assert not held(), "allocators hold as little by themselves"
    monkeypatch.setattr(freed_memory, "LARGE", 1)
    terrain.adaptive_terrain.viewport.error_px *= 2.0
    session.update_object(terrain, mode="RENDER")
    assert not held()
    session.update_object(terrain)
    assert held()
    handlers.on_render_pre(scene)
    assert not held()


@pytest.fixture
def timers(monkeypatch):
    """Return the list of timers of a fake Blender with a window and without known allocators."""
    registered = []
    faked = SimpleNamespace(
        is_registered=registered.__contains__,
        register=lambda function, *, first_interval, persistent: registered.append(function),
        unregister=registered.remove,
    )
    monkeypatch.setattr(freed_memory, "bpy", SimpleNamespace(app=SimpleNamespace(background=False, timers=faked)))
    monkeypatch.setattr(freed_memory, "_c_function", lambda name: None)
    return registered


def test_memory_is_given_back_when_no_mesh_came_for_a_while(timers, monkeypatch):
    freed_memory.give_back()
    asked, now = [], 100.0
    functions = {"mallopt": lambda *option: asked.append(option) or 1, "malloc_trim": asked.append}
    monkeypatch.setattr(freed_memory, "_c_function", functions.get)
    monkeypatch.setattr(freed_memory.time, "monotonic", lambda: now)
    freed_memory.hold_freed_memory()
    now += 3.0
    freed_memory.hold_freed_memory()
    assert len(timers) == 1 and len(asked) == 2
    now += 3.0
    assert freed_memory._give_back_when_idle() == pytest.approx(freed_memory.IDLE_S - 3.0) and held()
    now += 3.0
    assert freed_memory._give_back_when_idle() is None and not held() and len(asked) == 5
    freed_memory.give_back()
    assert len(asked) == 5
    freed_memory.unregister()
    assert timers == []


def test_other_allocators_are_left_alone(timers):
    freed_memory.give_back()
    freed_memory.hold_freed_memory()
    assert timers == [] and not held()


def test_arenas_that_come_later_are_held_too(timers, monkeypatch):
    """jemalloc creates the arena of large arrays with the first such array."""
    decays = {0: 10_000}

    def mallctl(name, old, _old_size, new, _new_size):
        if name == b"arenas.narenas":
            old._obj.value = 1 + max(decays)
            return 0
        arena = int(name.split(b".")[1])
        if arena not in decays:
            return 14
        old._obj.value, decays[arena] = decays[arena], new._obj.value
        return 0

    freed_memory.give_back()
    monkeypatch.setattr(freed_memory, "_c_function", {"mallctl": mallctl}.get)
    freed_memory.hold_freed_memory()
    assert decays == {0: -1}
    decays[2] = 0
    freed_memory.hold_freed_memory()
    assert decays == {0: -1, 2: -1}
    freed_memory.give_back()
    assert decays == {0: 10_000, 2: 0} and not held()
