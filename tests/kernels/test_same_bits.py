# SPDX-License-Identifier: GPL-3.0-or-later
"""The same frames give the same bytes and the same bounds on every processor."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import rough

# OpenBLAS picks its kernels by the first, numpy its loops by the second, glibc its functions by the third, and Warp
# compiles for the last: x86-64 has no fused multiply-add and no vectors longer than two doubles. Sines differ by the
# third, products by the first.
CORES = {
    "oldest": ("Nehalem", "SSE42 AVX F16C FMA3 AVX2 AVX512F AVX512CD AVX512_SKX", "-AVX2,-FMA,-AVX", "x86-64"),
    "older": ("Haswell", "AVX512F AVX512CD AVX512_SKX", "-FMA", ""),
    "newest": ("SkylakeX", "", "", ""),
}


def digest() -> str:
    """Return a digest of one terrain's updates for unusual cameras."""
    field, found = rough(65, 97, seed=3), hashlib.blake2b()
    placement = np.eye(4)
    placement[:3, :3] += 0.2 * np.sin(np.arange(9.0)).reshape(3, 3)
    terrain = Terrain(field, 1)
    for n, kind in enumerate((PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE)):
        fov = 300.0 if kind == PANORAMIC else 47.3
        eye, target = (-310.7 + 40.1 * n, -290.3, 211.9), (3.1, 7.7 * n, 20.3)
        view = View.look(eye, target, kind=kind, fov_deg=fov, ortho_width=501.3, roll_deg=11.3 * n)
        criterion = Criterion(error_px=0.7, edge_px=31.3, error_m=1.3, guard_deg=3.3, max_depth=13 if n == 3 else None)
        update = terrain.update(criterion, [view], placement, 1.1, 3.7)
        for array in (update.surface.positions, update.surface.normals, update.surface.triangles):
            found.update(np.ascontiguousarray(array))
        bounds = update.bound_px, update.bound_m, update.bound_edge_px, update.terms_px, update.terms_m, update.limited
        found.update(repr(bounds).encode())
    return found.hexdigest()


def digest_on(cores: str, cache) -> str:
    """Return `digest` of a child process; modules compiled for another processor are cached in a folder."""
    core, without, tunables, target = CORES[cores]
    paths = [str(Path(__file__).parent), *sys.path]
    script = f"import sys, warp as wp; sys.path[:0] = {paths!r}; wp.config.quiet = True\n"
    if target:
        script += f"wp.config.cpu_compiler_flags = '-target-cpu {target}'\n"
        script += f"wp.config.kernel_cache_dir = {str(cache)!r}\n"
    script += "import test_same_bits; print(test_same_bits.digest())"
    environment = os.environ | {"OPENBLAS_CORETYPE": core, "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={tunables}"}
    environment["NPY_DISABLE_CPU_FEATURES"] = without
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], env=environment, capture_output=True, text=True, timeout=200
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.split()[-1]


@pytest.mark.thorough
@pytest.mark.parametrize("cores", CORES)
def test_other_processors_make_the_same_bytes(cores, tmp_path):
    assert digest_on(cores, tmp_path) == digest()
