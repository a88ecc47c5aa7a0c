# SPDX-License-Identifier: GPL-3.0-or-later
"""Profiles of the rows that fall short of their goals: which part of their work takes which share of their time.

`python -m adaptive_terrain.benchmarks.profile` (`make profile`) samples the same scenes as `bench` (sampling.py) and
writes pages/profiles.json, from which docs/performance.md shows them. Shares, not times: a share stays what
it is when something else runs on the machine.
"""

import datetime
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from ..cbt_terrain.errors import TerrainError
from ..operators.text.machine import machine
from .pages.profiles import (
    BAND,
    BAND_TEST,
    BLENDER,
    BLOCK,
    BOX,
    COPY,
    DESCENT,
    DISPLACE,
    ERRORS,
    FILE,
    KEPT,
    LEAF,
    MERGED,
    OTHER,
    OUR_WRITER,
    PIXEL,
    PYTHON,
    SEARCH,
    SHADE,
    SYNC,
    SYSTEM,
    TREE,
    WELD,
    in_words,
)
from .rig import sampling
from .rig.sampling import Sample

SECONDS = 4.0
CYCLES_SECONDS = 30.0
LAPS = 75  # frames of a flight, as in the benchmark; then it starts again
LEAST_SHARE = 0.01  # smaller parts are added up as OTHER
# The walk's functions, each to its part; what they call is theirs where it is not named. The loop itself is DESCENT.
PARTS = {
    **dict.fromkeys(("error_at", "raster_error_at", "detail_missed", "fetch_children", "fetch_ahead"), ERRORS),
    "judge": BAND_TEST,
    "diamond_at": BOX,
    **dict.fromkeys(("measured_at", "finest", "too_coarse"), PIXEL),
    "band_below": BAND,
    **dict.fromkeys(("begin_keeping", "take", "looks_for_subtree", "open_subtree", "note_turning"), KEPT),
    "close_subtree": KEPT,
    "emit_block": BLOCK,
    **dict.fromkeys(("emit", "stands_alone"), LEAF),
    **dict.fromkeys(("square_at", "enter", "advance"), DESCENT),
}
# Kernels by their module, where it is not the walk's.
MODULES = {
    "count": SEARCH,
    "weld": WELD,
    "weld_border": WELD,
    "displace": DISPLACE,
    "ingest": OUR_WRITER,
}
KERNELS_OF_REFINEMENT = ("walk.",)
CYCLES_SYNC = ("create_mesh", "ccl::Mesh::", "GuardedAllocator", "BlenderSync", "MeshManager", "GeometryManager")


def part_of(sample: Sample) -> str:
    """Which part of a row's work a sample belongs to."""
    module, _, _ = sample.kernel.partition(".")
    if module == "walk":
        if not sample.frames:
            return MERGED
        named = [PARTS[name] for _, name, _ in sample.frames if name in PARTS]
        return named[-1] if named else DESCENT
    if module:
        return MODULES.get(module, OTHER)
    return _outside(sample.library, sample.symbol)


def _outside(library: str, symbol: str) -> str:
    if "kernel" in library:
        return SYSTEM
    if library.startswith("libembree"):
        return TREE
    if symbol.startswith(("__memmove", "__memset")):
        return COPY
    if library.startswith(("libpython", "_multiarray", "_ctypes", "python")):
        return PYTHON
    if "ccl::" in symbol:
        return SYNC if any(name in symbol for name in CYCLES_SYNC) else SHADE
    return BLENDER if "blender::" in symbol else OTHER


def scenes_of_rows(folder: Path) -> Iterator[tuple[str, int, str, float, Callable[[], object], tuple[str, ...]]]:
    """Row, size, which scene of it, seconds, the work, and the kernels that count (none named: everything counts)."""
    from ..operators.blender import need_bpy
    from .rig import scenes
    from .rows import cycles, cycles_frame, engine, in_blender

    flat, rough = scenes.flat(), scenes.rough()
    walk = KERNELS_OF_REFINEMENT
    for threads, sizes in engine.REFINE_SIZES.items():
        for size in sizes:
            flight = engine.edge_flight(flat, size, threads)
            yield f"refine_{threads}t", size, "", SECONDS, _lap(flight), walk
    million = engine.MILLION
    yield "refine_error", million, "", SECONDS, _lap(engine.error_flight(rough, million, 1)), walk
    yield "surface", million, "", SECONDS, _lap(engine.error_flight(rough, million)), ()
    for depth in (engine.DEPTHS[0], engine.DEPTHS[-1]):
        flight = engine.flight_at(flat, engine.DEPTHS[0], depth)
        yield "depth", engine.DEPTH_SIZE, f"depth {depth}", SECONDS, _lap(flight), walk
    limited, _plain = engine.budget_criteria(rough, scenes.over(0), scenes.errors)
    flight = scenes.Flight(rough, scenes.over, limited, 1)
    yield "budget_flight", engine.BUDGET_SIZE, "", SECONDS, _lap(flight), (*walk, "count.")
    need_bpy("A profile of the rows cycles")
    store = in_blender.keep(rough, folder / "rough")
    for mode in (cycles.ERROR,):
        render, triangles = _renders(*cycles_frame.render_scene(mode, str(store), "", cycles.PIXEL))
        render()
        yield f"cycles_{mode}", triangles[0], "", CYCLES_SECONDS, render, ()


def _lap(flight) -> Callable[[], None]:
    def fly() -> None:
        if flight.frame == LAPS:
            flight.frame = -1
        flight()

    return fly


def _renders(scene, obj) -> tuple[Callable[[], None], list[int]]:
    import bpy

    from ..operators.text.console import quiet

    triangles: list[int] = []
    bpy.app.handlers.render_post.append(lambda *_: triangles.append(len(obj.data.polygons)))

    def render() -> None:
        scene.frame_set((scene.frame_current + 1) % LAPS)
        with quiet():
            bpy.ops.render.render()

    return render, triangles


def shares(samples: Counter[Sample], kernels: tuple[str, ...]) -> tuple[int, dict[str, float]]:
    """How many samples count, and the share of each part, the largest first; small parts are added up."""
    parts: Counter[str] = Counter()
    for sample, count in samples.items():
        if not kernels or sample.kernel.startswith(kernels):
            parts[part_of(sample)] += count
    total = sum(parts.values())
    large = {part: count for part, count in parts.most_common() if part != OTHER and count >= LEAST_SHARE * total}
    found = {part: count / total for part, count in large.items()}
    if (rest := total - sum(large.values())) > 0:
        found[OTHER] = rest / total
    return total, found


def main() -> None:
    from .pages.report import write_text  # imports kernels, which must wait for `with_lines`

    sampling.need_tools()
    profiles = []
    with tempfile.TemporaryDirectory(prefix="adaptive-terrain-profile-") as folder:
        for row, size, scene, seconds, work, kernels in scenes_of_rows(Path(folder)):
            for _ in range(2):  # compiles, and touches all memory
                work()
            count, parts = shares(sampling.sampled(work, seconds), kernels)
            profiles.append({"row": row, "size": size, "scene": scene, "samples": count, "parts": parts})
            print(f"{row} {size:,} {scene}: {in_words(parts)}", flush=True)
    content = {"date": datetime.date.today().isoformat(), "machine": machine(), "profiles": profiles}
    write_text(FILE, json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    sampling.with_lines()
    try:
        main()
    except TerrainError as error:
        sys.exit(f"profile: {error}")
