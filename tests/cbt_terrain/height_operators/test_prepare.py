# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of a stack are known before its launch, and compiling them reports progress."""

import json
import subprocess
import sys
from pathlib import Path

from adaptive_terrain.cbt_terrain.height_operators import prepare as preparation
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.prepare import kernels_of, prepare
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack

FORESEEN = """
import json, sys
import numpy as np
import warp as wp
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators.prepare import kernels_of
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import stack_from
from adaptive_terrain.cbt_terrain.height_operators.tiles import whole_land
from adaptive_terrain.cbt_terrain.run.warmup import other_modules
field = from_array(np.random.default_rng(0).random((40, 50), np.float32) * 900, 30.0)
found = []
for content in json.loads(sys.argv[1]):
    stack = stack_from(content)
    before = {m.__name__ for m in other_modules() if wp.get_module(m.__name__).execs}
    shape(field, stack, whole_land(field.lattice))
    after = {m.__name__ for m in other_modules() if wp.get_module(m.__name__).execs}
    found.append([sorted(after - before), sorted(after), sorted(m.__name__ for m in kernels_of(stack))])
print(json.dumps(found))
"""


def test_kernels_that_stacks_launch_are_foreseen():
    """In a new process each operator loads only foreseen modules, and at most two of these are not loaded."""
    wet = {"rules": [{"of": "wetness", "low": 1.0}]}
    seen = {"rules": [{"of": "sky", "low": 0.9}]}
    entries = [{"effect": "relief"}, {"effect": "relief", "mask": wet}, {"effect": "relief", "mask": seen}]
    entries += [{"effect": name} for name in ("snow", "scree", "water", "rivers", "droplets")]
    entries += [{"effect": "flood", "parameters": {"minutes": 0.1}}]
    stacks = [{"version": 1, "entries": [entry]} for entry in entries]
    given = [sys.executable, "-c", FORESEEN, json.dumps(stacks)]
    done = subprocess.run(given, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    for new, loaded, foreseen in found:
        assert set(new) <= set(foreseen) and len(set(foreseen) - set(loaded)) <= 2
    assert any(name.endswith("relief") for name in found[0][0]) and any("flow" in name for name in found[1][0])


def test_compiling_reports_progress_and_happens_once(monkeypatch):
    stack = Stack((Entry("scree", mask=HeightMask("", (GroundRule("flow", low=1e3),))), Entry("snow", on=False)))
    names = [module.__name__.rpartition(".")[2] for module in kernels_of(stack)]
    assert {"thermal", "flow", "routing"} <= set(names) and "snow" not in names
    loaded, said = [], []
    monkeypatch.setattr(preparation.warmup, "load", loaded.append)
    monkeypatch.setattr(preparation.warmup, "compiled_file", lambda module: Path("/nowhere"))
    prepare(stack, lambda fraction, message: said.append((fraction, message)))
    assert said == [(0.0, f"Preparing kernels, {k} of {len(names)}") for k in range(1, len(names) + 1)]
    monkeypatch.setattr(preparation.warmup, "compiled_file", lambda module: Path("/"))
    said.clear()
    prepare(stack, lambda *told: said.append(told))
    assert not said and set(loaded) == set(kernels_of(stack))
