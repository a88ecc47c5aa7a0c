# SPDX-License-Identifier: GPL-3.0-or-later
"""The real Blender program with the extension's zip built, installed and enabled in a private user folder: once a
session, for tests/blender and those hard cases that need it (tests/conftest.py names the fixtures).

`ADAPTIVE_TERRAIN_BLENDER` is the wrapper that tools/get_blender.sh writes; `.ci/run` sets it, and without it these
tests are skipped.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SUPPORT, SCRIPTS = ROOT / "tests" / "support", ROOT / "tests" / "blender" / "scripts"
# Puts the modules that scripts import on the path; Blender does not look beside a script.
PATHS = f"import sys; sys.path += {[str(SUPPORT), str(SCRIPTS)]}"
MARK = "RESULT "
EXTENSION = "bl_ext.user_default.adaptive_terrain"
# Kernels that the program compiles itself, as in a fresh install: of a requested effect, and in the test
# of its panel those of a frame, at its start.
EFFECT, FRAME = "effects.jet", "mesh.weld"


class Program:
    """The real program. `user` is its private user folder, `kernels` where its compiled kernels are kept."""

    def __init__(self, wrapper: str, user: Path):
        self.wrapper, self.user, self.kernels = wrapper, user, user / "kernels"

    def environment(self) -> dict[str, str]:
        home, shaders = self.user / "home", self.user / "shaders"
        for folder in (home, shaders):
            folder.mkdir(parents=True, exist_ok=True)
        paths = {"BLENDER_USER_RESOURCES": str(self.user), "HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache")}
        paths |= {"BIND": str(self.user), "WARP_CACHE_PATH": str(self.kernels)}
        # Mesa compiles the shaders of a window by software for eight seconds of a processor: once.
        paths |= {"MESA_SHADER_CACHE_DIR": str(shaders)}
        return {**os.environ, **paths, "LIBGL_ALWAYS_SOFTWARE": "1", "PYTHONPATH": ""}

    def command(self, *arguments: str) -> list[str]:
        return [self.wrapper, "blender", *map(str, arguments)]

    def run(self, *arguments: str, timeout: float = 300) -> str:
        """Run to the end; return the output, and fail with it unless the exit code is 0."""
        done = subprocess.run(
            self.command(*arguments), env=self.environment(), cwd=ROOT, capture_output=True, text=True, timeout=timeout
        )
        assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    def script(self, name: str, *arguments: str, blend: Path | None = None, timeout: float = 300) -> dict:
        """Run a script of tests/blender/scripts without a window; returns the JSON that it prints after RESULT."""
        command = ["-b", *([blend] if blend else []), "--python-exit-code", "1", "--python-expr", PATHS]
        output = self.run(*command, "--python", SCRIPTS / name, "--", *arguments, timeout=timeout)
        results = [line for line in output.splitlines() if line.startswith(MARK)]
        assert len(results) == 1, output
        return json.loads(results[0][len(MARK) :])


def build_zip(program: Program, output: Path) -> Path:
    """Build the zip for this platform and the program's Python; the real program validates and packs it."""
    command = [sys.executable, ROOT / "tools" / "build_extension.py", "--output", output]
    command += ["--blender", *program.command()]
    subprocess.run(command, check=True, cwd=ROOT, env=program.environment())
    [path] = output.glob("*.zip")
    return path


def lend_kernels(cache: Path, *missing: str) -> None:
    """Copy compiled kernels of this Python into the program's cache, except those whose names begin with `missing`:
    compiling all takes a minute of a core. The same source is the same object; only its name says whose package it
    belongs to."""
    from adaptive_terrain.cbt_terrain.run import warmup

    for module in [*warmup.kernel_modules(), *warmup.overlay_modules(), *warmup.other_modules()]:
        compiled, short = warmup.compiled_file(module), module.__name__.removeprefix(warmup.HOUSE)
        if compiled.exists() and not short.startswith(missing):
            for file in compiled.parent.iterdir():
                lent = [part.replace(warmup.child.PACKAGE, EXTENSION) for part in file.parts[-2:]]
                copy = cache.joinpath(compiled.parts[-3], *lent)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, copy)


def processes(mark: str) -> list[int]:
    """Blender programs, and their children, whose command line or environment names this folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (process / "environ").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.fixture(scope="session")
def bare_program(tmp_path_factory):
    wrapper = os.environ.get("ADAPTIVE_TERRAIN_BLENDER")
    if not wrapper:
        pytest.skip(
            "ADAPTIVE_TERRAIN_BLENDER is not set: tools/get_blender.sh trixie .cache/blender writes the program"
        )
    return Program(str(Path(wrapper).resolve()), tmp_path_factory.mktemp("user"))


@pytest.fixture(scope="session")
def extension_zip(bare_program, tmp_path_factory):
    return build_zip(bare_program, tmp_path_factory.mktemp("extension"))


@pytest.fixture(scope="session")
def program(bare_program, extension_zip):
    """Install and enable the extension; show no splash screen and draw viewports once.

    Eight draws for smooth edges, by software, take two thirds of the time of tests with a window.
    """
    bare_program.run("--command", "extension", "install-file", "-r", "user_default", "--enable", extension_zip)
    quiet = "import bpy; preferences = bpy.context.preferences; preferences.view.show_splash = False; "
    quiet += "preferences.system.viewport_aa = 'OFF'; preferences.system.use_region_overlap = False; "
    quiet += "bpy.ops.wm.save_userpref()"
    # An empty asset library, or the first window would write one.
    quiet += f"; from {EXTENSION}.operators.assets import library; folder = library.library_folder(create=True); "
    quiet += "(folder / library.BLEND).touch(); (folder / library.STAMP).write_text(library._stamp())"
    bare_program.run("-b", "--python-expr", quiet)
    lend_kernels(bare_program.kernels, EFFECT)
    return bare_program


def read_dem():
    """Return matplotlib's DEM (Jacksboro fault, SRTM at 3 arc seconds): `elevation`, `xmin` and so on."""
    from matplotlib import cbook

    return cbook.get_sample_data("jacksboro_fault_dem.npz")


def write_dem(path: Path, heights: np.ndarray) -> None:
    """Write heights as a GeoTIFF in the place of that DEM."""
    import rasterio
    from rasterio.transform import from_bounds

    rows, columns = heights.shape
    data = read_dem()
    bounds = (float(data[key]) for key in ("xmin", "ymin", "xmax", "ymax"))
    placed = {"crs": "EPSG:4326", "transform": from_bounds(*bounds, columns, rows)}
    shape = {"width": columns, "height": rows, "count": 1, "dtype": heights.dtype}
    with rasterio.open(path, "w", driver="GTiff", **placed, **shape) as tif:
        tif.write(heights[None])


@pytest.fixture(scope="session")
def dem(tmp_path_factory):
    """Write matplotlib's DEM as GeoTIFF, in whole metres, and as EXR."""
    import OpenEXR

    heights, folder = np.asarray(read_dem()["elevation"], np.float32), tmp_path_factory.mktemp("dem")
    write_dem(folder / "dem.tif", heights)
    write_dem(folder / "whole.tif", heights.astype(np.int16))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": heights}).write(str(folder / "dem.exr"))
    return {"tif": folder / "dem.tif", "exr": folder / "dem.exr", "whole": folder / "whole.tif", "heights": heights}


@pytest.fixture(scope="session")
def scene(program, dem, tmp_path_factory):
    """Save a .blend with the GeoTIFF as terrain and an animated camera by the real program; return both."""
    path = tmp_path_factory.mktemp("scene") / "scene.blend"
    return path, program.script("import_dem.py", path, dem["tif"])


@pytest.fixture
def release(monkeypatch):
    """Import tools/release.py, for one test."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import release

    yield release
    del sys.modules["release"], sys.modules["build_extension"]
