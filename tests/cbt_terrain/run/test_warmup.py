# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels are prepared by child processes, under their names in this process, without needless waiting."""

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import child, launch, warmup
from forked_programs import run_program

ROOT = Path(__file__).resolve().parents[3]


def with_kernels(folder: Path) -> set[str]:
    return {path.stem for path in folder.glob("*.py") if "wp.kernel" in path.read_text("utf-8")}


OF_A_FRAME = set().union(
    *(with_kernels(ROOT / "kernels" / room) for room in ("field", "tree", "refine", "budget", "mesh"))
)
OF_A_FRAME -= {"horizon_map", "split_merge", "edits"}  # occlusion and edits of single nodes are compiled on demand
OF_THE_OVERLAY = with_kernels(ROOT / "kernels" / "accuracy")
# Modules that compile quickly; all would take half a minute.
QUICK = "fill", "holes", "replay", "meshlet", "drawing", "grid"
# Prepares some modules of every room under the name of an extension, and prints those that it compiled.
PREPARE = """
import importlib.util, json, os, sys, time, types
root, name = sys.argv[1], "bl_ext.user_default.terrain"
sys.modules.update({outer: types.ModuleType(outer) for outer in ("bl_ext", "bl_ext.user_default")})
spec = importlib.util.spec_from_file_location(name, root + "/__init__.py", submodule_search_locations=[root])
sys.modules[name] = package = importlib.util.module_from_spec(spec)
spec.loader.exec_module(package)
warmup = importlib.import_module(name + ".cbt_terrain.run.warmup")
modules_of = warmup.modules_of
warmup.FIRST_CLICKS = (f"{name}.kernels.effects.pyramid",)
warmup.modules_of = lambda room: [m for m in modules_of(room) if m.__name__.rpartition(".")[2] in sys.argv[2:]]
compiled_here = []
import warp as wp
compile_module = wp.Module._compile
def watched(self, *arguments, **options):
    done = compile_module(self, *arguments, **options)
    compiled_here.extend([self.name] if done else [])
    return done
wp.Module._compile = watched
importlib.import_module(name + ".cbt_terrain.run.launch").default_threads = lambda: 3  # two children
warmup.start()
seen = []
while warmup.preparing():
    seen.append(warmup.progress())
    time.sleep(0.002)
seen.append(warmup.progress())
overlay_before = sum(bool(wp.get_module(m.__name__).execs) for m in warmup.overlay_modules())
warmup.wait(overlay=True)
seen.append(warmup.progress())
later = importlib.import_module(warmup.FIRST_CLICKS[0])
warmup._current.thread.join()
modules = warmup.kernel_modules() + warmup.overlay_modules()
time_of = lambda module: warmup.compiled_file(module).stat().st_mtime_ns
# The first of the two children compiles it after the modules of its own share; the second may take longer.
later_before = any(time_of(later) < time_of(module) for module in warmup.kernel_modules()[::2])
print(json.dumps({
    "seconds": sum(os.times()[:4]),
    "compiled_here": compiled_here,
    "fractions": sorted({f for f in seen if f is not None}),
    "missing": [m.__name__ for m in modules if not warmup.compiled_file(m).exists()],
    "loaded": sum(bool(wp.get_module(m.__name__).execs) for m in modules),
    "modules": len(modules),
    "overlay_before": overlay_before,
    "later": [later_before, warmup.compiled_file(later).exists(), bool(wp.get_module(later.__name__).execs)],
    "folders": sorted(os.listdir(wp.config.kernel_cache_dir)),
}))
"""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """Return the output of starts with an empty cache, with a full one, and with one of another kind of processor."""
    cache = tmp_path_factory.mktemp("kernels")
    environment = {**child.os.environ, "WARP_CACHE_PATH": str(cache)}

    def prepare():
        command = [sys.executable, "-c", PREPARE, str(ROOT), *QUICK]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    first, second = prepare(), prepare()
    compiled = sorted(cache.glob("*/*/*.o"), key=lambda file: file.stat().st_size)
    for file in compiled[: len(compiled) // 2]:  # of the others it left the same as this one would
        file.rename(file.with_name(f"{file.name.split('.cpu')[0]}.cpu01234567.o"))
    return first, second, prepare()


@pytest.mark.thorough
def test_children_compile_under_the_name_of_their_parent(prepared):
    first, _, _ = prepared
    assert first["compiled_here"] == [] and first["missing"] == []
    assert first["loaded"] == first["modules"] == len(QUICK)
    assert first["overlay_before"] == 0, "a terrain is shown before the overlay's kernels are there"
    assert all(name.startswith("wp_bl_ext.user_default.terrain.kernels.") for name in first["folders"])
    assert len(first["folders"]) == first["modules"] + 1
    assert first["later"] == [False, True, False], "the first buttons' kernels come after a frame's and are not loaded"
    assert first["fractions"][0] == 0.0 and len(first["fractions"]) > 3, "the panel shows how far it is"


@pytest.mark.thorough
def test_a_full_cache_needs_no_child(prepared):
    first, second, _ = prepared
    assert second["compiled_here"] == [] and second["loaded"] == second["modules"]
    assert second["fractions"] == [], "nothing to be seen of it"
    assert second["folders"] == first["folders"]
    assert second["seconds"] < first["seconds"] / 2, "of the processor, children included"


@pytest.mark.thorough
def test_what_another_processor_left_is_compiled_by_children_too(prepared):
    first, _, elsewhere = prepared
    assert elsewhere["compiled_here"] == [] and elsewhere["missing"] == []
    assert elsewhere["folders"] == first["folders"]
    assert len(elsewhere["fractions"]) > 1, "half of the modules are there; two children may end at once"


@pytest.fixture
def no_modules(monkeypatch):
    """Start a preparation whose children only sleep."""
    sleeping = []

    def start(module, *arguments, variables, **streams):
        sleeping.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], **streams))
        return sleeping[-1]

    monkeypatch.setattr(child, "start", start)
    monkeypatch.setattr(launch, "default_threads", lambda: 4)
    monkeypatch.setattr(warmup, "compiled_file", lambda module: Path("/nowhere"))
    monkeypatch.setattr(warmup, "_current", None)
    monkeypatch.setattr(warmup, "_requested", None)
    yield sleeping
    warmup.stop()


def test_stopping_ends_the_children_and_tells_who_waits(no_modules):
    warmup.start()
    reasons = []

    def waiter():
        try:
            warmup.wait()
        except TerrainError as reason:
            reasons.append(str(reason))

    thread = threading.Thread(target=waiter)
    thread.start()
    while len(no_modules) < 3:
        threading.Event().wait(0.01)
    assert warmup.preparing() and warmup.progress() == 0.0
    warmup.stop()
    thread.join(60)
    assert reasons and "switched off" in reasons[0]
    assert all(process.poll() is not None for process in no_modules)
    assert not warmup.preparing() and warmup.progress() is None
    warmup.wait()  # nothing is under way: kernels are loaded when they are launched


def test_without_a_child_the_thread_compiles(monkeypatch):
    def fail(*arguments, **streams):
        raise OSError("no process")

    monkeypatch.setattr(child, "start", fail)
    monkeypatch.setattr(warmup, "compiled_file", lambda module: Path("/nowhere"))
    monkeypatch.setattr(warmup, "_current", None)
    loaded = []
    monkeypatch.setattr(warmup, "load", lambda module: loaded.append(module.__name__.rpartition(".")[2]))
    warmup.start()
    warmup.wait(overlay=True)
    warmup.stop()
    assert set(loaded) == OF_A_FRAME | OF_THE_OVERLAY
    assert set(loaded[: len(OF_A_FRAME)]) == OF_A_FRAME, "those of a frame come first"


def test_every_room_of_kernels_is_in_one_list():
    rooms = [folder.parent.name for folder in (ROOT / "kernels").glob("*/__init__.py")]
    assert sorted((*warmup.FRAME, *warmup.OVERLAY, *warmup.OTHERS)) == sorted(rooms)


def test_what_a_scene_asks_for_is_prepared_once_with_a_bar(no_modules, monkeypatch):
    monkeypatch.setattr(warmup, "_tried", set())
    wanted = warmup.other_modules()[:2]
    loaded = []
    monkeypatch.setattr(warmup, "load", loaded.append)
    assert not warmup.prepare_modules(wanted) and warmup.preparing()
    while len(no_modules) < 3:
        threading.Event().wait(0.01)
    assert warmup.progress() == 0.0 and not warmup.prepare_modules(wanted), "they are under way"
    for process in no_modules:
        process.kill()
    warmup.wait()
    assert loaded == wanted and warmup.prepare_modules(wanted) and not warmup.preparing()
    assert warmup.prepare_modules([])


def test_what_cannot_be_compiled_is_tried_once(monkeypatch, capfd):
    monkeypatch.setattr(warmup, "_tried", set())
    monkeypatch.setattr(warmup, "_requested", None)
    monkeypatch.setattr(warmup, "compiled_file", lambda module: Path("/"))
    monkeypatch.setattr(warmup, "load", lambda module: 1 / 0)
    wanted = warmup.other_modules()[:1]
    assert not warmup.prepare_modules(wanted)
    warmup.wait()
    assert warmup.prepare_modules(wanted) and "ZeroDivisionError" in capfd.readouterr().err


FORESEEN = """
import json, sys
import numpy as np
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.attributes.evaluate import kernels_of
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.run.warmup import other_modules
from adaptive_terrain.cbt_terrain.terrain import Terrain
launch._loaded.clear()  # the forked process has loaded more
field = from_array(np.random.default_rng(0).random((40, 50), np.float32) * 9, 3.0)
view = View.look((50, 50, 60), (0, 0, 0), resolution=(60, 40))
surface = Terrain(field, 1).update(Criterion(error_px=1.0), [view]).surface
wanted = plan([AttributeRequest(name, ("a test",)) for name in sys.argv[1:]])
evaluate(field, EffectRequest(wanted, surface, [view]), FrameHistory())
loaded = {m.__name__ for m in other_modules()} & {kernel.module.name for kernel in launch._loaded}
print(json.dumps([sorted(loaded), sorted(m.__name__ for m in kernels_of(wanted))]))
"""


@pytest.mark.parametrize(
    "names",
    [
        ["sky", "sun"],
        *(pytest.param(names, marks=pytest.mark.thorough) for names in (["slope"], ["splat_1", "wetness"])),
    ],
)
def test_kernels_that_effects_launch_are_foreseen(names):
    """A new process loads the predicted kernels, or fewer."""
    done = run_program(FORESEEN, *names)
    assert done.returncode == 0, done.stderr
    loaded, foreseen = json.loads(done.stdout.splitlines()[-1])
    assert loaded and set(loaded) <= set(foreseen)
    assert len(foreseen) <= len(loaded) + 2, "and few more"
