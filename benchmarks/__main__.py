# SPDX-License-Identifier: GPL-3.0-or-later
"""What an update costs, as ratios to a serial C bintree measured in the same run: `python -m benchmarks`.

Columns: name, leaves, our median and the best of the baseline in milliseconds, and their ratio. The baseline
(roam_rebuild.c) rebuilds the refinement of the unit square from its roots; ours moves the camera by 0.1 % of the side a
frame, so that every frame's mesh is new.
"""

import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.criterion import Criterion
from adaptive_terrain.cbt_terrain.heightfield import HeightField, from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view import PANORAMIC, View

RUNS = 9
SIDE = 4096.0  # metres
SIZES = (5_500, 50_000, 500_000, 1_000_000)


def roam_rebuild(folder: Path) -> dict[int, float] | None:
    """Milliseconds of one rebuild by size; None without a C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    source, program = Path(__file__).with_name("roam_rebuild.c"), folder / "roam_rebuild"
    subprocess.run([compiler, "-O3", "-march=native", str(source), "-o", str(program), "-lm"], check=True)
    times = {}
    for size in SIZES:
        command = [str(program), "--depth", "27", "--leaves", str(size), "--runs", str(RUNS)]
        times[size] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)[
            "rebuild_ms"
        ]
    return times


def flat() -> HeightField:
    return from_array(np.zeros((4097, 4097), np.float32), SIDE / 4096)


def rough() -> HeightField:
    """Spectral noise, 4097 x 4097: height falls with frequency to the power 2.2."""
    n, rng = 4097, np.random.default_rng(1)
    frequency = np.fft.rfftfreq(n)[None, :] ** 2 + np.fft.fftfreq(n)[:, None] ** 2
    frequency[0, 0] = 1
    spectrum = rng.standard_normal((n, n // 2 + 1)) * frequency**-1.1
    spectrum[0, 0] = 0
    z = np.fft.irfft2(spectrum, (n, n))
    return from_array((z / z.std() * 30).astype(np.float32), SIDE / 4096)


def around(frame: int) -> View:
    eye = np.array([-0.07 * SIDE + 0.001 * SIDE * frame, 0.07 * SIDE, 2.0])
    return View.look(eye, eye + [1, 0, 0], kind=PANORAMIC, fov_deg=360)


def over(frame: int) -> View:
    eye = np.array([-0.4 * SIDE + 0.001 * SIDE * frame, -0.5 * SIDE, 250.0])
    return View.look(eye, (0, 0, 0))


def measure(field: HeightField, views, asked, leaves: int, threads: int) -> tuple[int, dict[str, float]]:
    """Leaves and median milliseconds by step of moving frames at about `leaves` leaves; `asked(x)` is the criterion."""
    low, high = 1e-4, 1e4
    probe = Terrain(field, threads)
    for _ in range(24):
        middle = (low * high) ** 0.5
        found = probe.update(asked(middle, int(1.2 * leaves)), [views(0)])
        low, high = (middle, high) if found.leaves > leaves or found.limited == "max_triangles" else (low, middle)
    terrain = Terrain(field, threads)
    rows = [terrain.update(asked(high, None), [views(frame)]) for frame in range(RUNS + 3)][3:]
    assert all(row.changed for row in rows)
    steps = {step: statistics.median(row.ms[step] for row in rows) for step in rows[0].ms}
    return rows[-1].leaves, steps


def edges(px: float, budget: int | None) -> Criterion:
    return Criterion(error_px=0, edge_px=px, max_depth=27, max_triangles=budget)


def errors(px: float, budget: int | None) -> Criterion:
    return Criterion(error_px=px, max_triangles=budget)


def still(field: HeightField) -> float:
    terrain, view = Terrain(field), over(0)
    terrain.update(Criterion(error_px=0.3), [view])
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        assert not terrain.update(Criterion(error_px=0.3), [view]).changed
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        baseline = roam_rebuild(Path(folder))
    if baseline is None:
        print("no C compiler: the baseline is left out", file=sys.stderr)

    def row(name: str, size: int, leaves: int, ms: float) -> None:
        base = baseline[size] if baseline else float("nan")
        print(
            f"{name:14} {leaves:>9,} leaves {ms:9.2f} ms   baseline {base:7.2f} ms   ratio {ms / base:6.3f}", flush=True
        )

    plain, detailed = flat(), rough()
    for threads in (1, 2):
        for size in SIZES:
            leaves, ms = measure(plain, around, edges, size, threads)
            row(f"refine_{threads}t", size, leaves, ms["refine"] + ms["mark"])
        leaves, ms = measure(detailed, over, errors, 1_000_000, threads)
        row(f"refine_error_{threads}t", 1_000_000, leaves, ms["refine"] + ms["mark"])
    row("surface_2t", 1_000_000, leaves, ms["total"])
    row("still", 1_000_000, leaves, still(detailed))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
