# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples become parts of a row's work, and the page shows their shares."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from adaptive_terrain.benchmarks import profile
from adaptive_terrain.benchmarks.pages import goals, profiles
from adaptive_terrain.benchmarks.pages.profiles import (
    BAND_TEST,
    BLOCK,
    BOX,
    COPY,
    DESCENT,
    LEAF,
    MERGED,
    OTHER,
    SYSTEM,
    WELD,
)
from adaptive_terrain.benchmarks.rig import sampling
from adaptive_terrain.benchmarks.rig.sampling import Sample
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.kernels.refine import walk

# Loads a small module of kernels with line tables and names what its first instructions come from.
RESOLVE = """
import json
from adaptive_terrain.benchmarks import profile
from adaptive_terrain.benchmarks.rig import sampling
sampling.with_lines()
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.kernels.refine import replay
warmup.load(replay)
kernels = sampling._loaded_kernels()
print(json.dumps({kernel.name: list(kernel.frames(list(range(0, kernel.size, 16))).values()) for kernel in kernels}))
"""


def in_walk(*called: str) -> Sample:
    frames = [("walk.py", "walk", 1), *(("diamond.py", name, 1) for name in called)]
    return Sample("walk.walk", tuple(frames))


def test_every_function_that_has_a_part_is_called_by_the_walk():
    """Or by what it calls: a function that was renamed would lose its part unseen."""
    rooms = Path(walk.__file__).parent
    calls = {path: set(re.findall(r"(\w+)\(", path.read_text())) for path in rooms.glob("*.py")}
    defined = {name: path for path in calls for name in re.findall(r"def (\w+)\(", path.read_text())}
    reached, new = set(), {Path(walk.__file__)}
    while new:
        reached |= new
        new = {defined[name] for path in new for name in calls[path] if name in defined} - reached
    assert {defined[name] for name in profile.PARTS} <= reached


def test_a_sample_belongs_to_one_part():
    assert profile.part_of(in_walk()) == DESCENT
    assert profile.part_of(in_walk("judge")) == BAND_TEST
    assert profile.part_of(in_walk("judge", "measured_at", "diamond_at", "place")) == BOX
    assert profile.part_of(in_walk("emit", "emit_leaf")) == LEAF
    assert profile.part_of(in_walk("emit", "emit_block", "write_block")) == BLOCK
    assert profile.part_of(Sample("walk.walk")) == MERGED
    assert profile.part_of(Sample("weld_border.weld_border")) == WELD
    assert profile.part_of(Sample(library="[kernel.kallsyms]", symbol="clear_page_erms")) == SYSTEM
    assert profile.part_of(Sample(library="libc.so.6", symbol="__memmove_avx512_unaligned_erms")) == COPY
    assert profile.part_of(Sample(library="libm.so.6", symbol="sin")) == OTHER


def test_shares_are_of_the_kernels_that_count():
    samples = Counter({in_walk("diamond_at"): 60, in_walk(): 40, Sample("weld.weld"): 100})
    count, parts = profile.shares(samples, profile.KERNELS_OF_REFINEMENT)
    assert count == 100 and list(parts)[:2] == [BOX, DESCENT] and parts[BOX] == 0.6
    assert sum(parts.values()) == pytest.approx(1.0)
    count, parts = profile.shares(samples, ())
    assert count == 200 and parts[WELD] == 0.5


def test_small_parts_are_added_up():
    samples = Counter({Sample("weld.weld"): 980, in_walk("diamond_at"): 8, in_walk(): 7, Sample(symbol="f"): 5})
    assert profile.shares(samples, ())[1] == {WELD: 0.98, OTHER: 0.02}


def test_perf_that_is_not_there_is_one_sentence(monkeypatch):
    monkeypatch.setattr(sampling.shutil, "which", lambda tool: None if tool == "perf" else f"/{tool}")
    with pytest.raises(TerrainError, match="A profile needs perf; install Linux perf and binutils."):
        sampling.need_tools()


@pytest.mark.skipif(not (shutil.which("addr2line") and shutil.which("nm")), reason="there are no binutils")
def test_instructions_are_followed_to_lines_of_python():
    done = subprocess.run([sys.executable, "-c", RESOLVE], env=os.environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    kernels = json.loads(done.stdout.splitlines()[-1])
    assert set(kernels) >= {"replay.replay"}
    for name, chains in kernels.items():
        named = [chain for chain in chains if chain]
        assert len(named) > len(chains) / 2
        assert {(chain[0][0], chain[0][1]) for chain in named} == {("replay.py", name.partition(".")[2])}


def test_the_page_shows_what_was_profiled(tmp_path):
    file = tmp_path / "profiles.json"
    assert profiles.section(file) == []
    rows = [
        {"row": "refine_1t", "size": 5_500, "scene": "", "samples": 900, "parts": {BOX: 0.6, DESCENT: 0.4}},
        {"row": "depth", "size": 500_000, "scene": "depth 20", "samples": 800, "parts": {BOX: 1.0}},
    ]
    machine = {"Processor": "Abacus 3", "Threads": "2"}
    file.write_text(json.dumps({"date": "2026-01-02", "machine": machine, "profiles": rows}))
    page = "\n\n".join(profiles.section(file))
    assert f"| refine_1t | 5,500 | {BOX} 60 %, {DESCENT} 40 % |" in page
    assert f"| depth, depth 20 | 500,000 | {BOX} 100 % |" in page
    assert "800 or more a scene), on 2026-01-02, Abacus 3, 2 threads" in page
    assert page.count(f"* **{BOX}**: ") == 1 and f"**{LEAF}" not in page


# What these take is in their reasons: kernels of their own, Python that asks Blender, or another program.
NOT_PROFILED = {
    "demand_large",
    "query_heights",
    "light_rays",
    "effects_cut",
    "effects_flight",
    "morph_flight",
    "morph_cut",
}
NOT_PROFILED |= {
    "frame",
    "splats",
    "land_sediment",
    "land_relief",
    "effects_ingest",
    "detail_displace",
    "program_ingest",
    "program_frame",
}


def test_every_row_that_falls_short_has_its_profile():
    content = json.loads(profiles.FILE.read_text())
    profiled = {(item["row"], item["size"]) for item in content["profiles"]}
    names = {row for row, _ in profiled}
    for name, size in goals.RECORDED:
        if name.endswith("_memory") or name in NOT_PROFILED:
            continue
        assert name in names if size == goals.ANY_SIZE else (name, size) in profiled
    for item in content["profiles"]:
        assert set(item["parts"]) <= set(profiles.MEANING) and sum(item["parts"].values()) == pytest.approx(1.0)
