# SPDX-License-Identifier: GPL-3.0-or-later
"""Take pictures of the window for docs/images in the real Blender program: `take_screenshots.py WRAPPER [SCENE ...]`.

WRAPPER is `.cache/blender.run`, written by tools/get_blender.sh. The scenes are those of SCENES, all by default: two of
the panel, and the first evening. The script needs root and some minutes, for the evening ten: it builds the
extension and installs it into a folder that is removed at the end.
"""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

import numpy as np  # noqa: E402
import program_window  # noqa: E402
from PIL import Image  # noqa: E402
from real_program import Program, build_zip, lend_kernels, read_dem, write_dem  # noqa: E402

# The size of the window and the pictures of each scene of screenshot_scenes.py.
EVENING = tuple(f"evening_{name}" for name in ("import", "scene", "water", "scatter", "trees", "picture"))
SCENES = {
    "first_import": ((1200, 800), ("first_import",)),
    "panel": ((1320, 1300), ("panel",)),
    "evening": ((1440, 900), EVENING),
}
MAX_SIDE = 1320  # pixels of a picture in the docs
EASTING, NORTHING = 600_000.0, 5_200_000.0  # of the evening's elevation model


def main() -> int:
    """Run the command line."""
    with tempfile.TemporaryDirectory(prefix="screenshots-", dir="/tmp") as name:
        folder = Path(name)
        program = Program(str(Path(sys.argv[1]).resolve()), folder / "user")
        install(program, folder)
        script = ROOT / "tools" / "screenshot_scenes.py"
        for scene in sys.argv[2:] or SCENES:
            model = folder / ("alps.tif" if scene == "evening" else "valley.tif")
            if scene == "evening":
                write_alps(model)
            else:
                write_dem(model, read_dem()["elevation"].astype(np.float32))
            size, pictures = SCENES[scene]
            program_window.SCREEN = size
            arguments = ["--python", script, "--", scene, folder, model]
            with program_window.window(program, arguments, folder, place=(0, 0, *size)) as blender:
                for picture in pictures:
                    program_window.wait_for(folder / f"{picture}.ready", blender)
                    save_picture(folder, picture)
    return 0


def save_picture(folder: Path, picture: str) -> None:
    """Save the render that the scene has written, or else the screen, and let the scene go on."""
    render = folder / f"{picture}.png"
    screen = Image.open(render).convert("RGB") if render.exists() else program_window.read_screen(folder)
    screen.thumbnail((MAX_SIDE, MAX_SIDE))
    screen.save(ROOT / "docs" / "images" / f"{picture}.jpg", quality=88)
    (folder / f"{picture}.ready").rename(folder / f"{picture}.saved")


def write_alps(path: Path) -> None:
    """Write the built-in mountains, shaped by their effects, as a GeoTIFF in UTM."""
    import bpy
    import rasterio
    from adaptive_terrain.cbt_terrain.field.store import open_store
    from adaptive_terrain.operators.blender import need_bpy
    from adaptive_terrain.operators.land import shaped_land

    need_bpy("the pictures")
    bpy.ops.wm.save_as_mainfile(filepath=str(path.with_name("alps.blend")))
    bpy.ops.mesh.adaptive_terrain_add(land="MOUNTAINS", natural_size=True, shape=True)
    bpy.ops.adaptive_terrain.shape()
    field = open_store(shaped_land.store_of(bpy.context.object))
    heights, step = field.heights()[::-1], field.lattice.step_x
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": "float32"}
    place = {"crs": "EPSG:32632", "transform": rasterio.transform.from_origin(EASTING, NORTHING, step, step)}
    with rasterio.open(path, "w", driver="GTiff", compress="deflate", **shape, **place) as tif:
        tif.write(np.round(heights, 2), 1)


def install(program: Program, folder: Path) -> None:
    """Build the extension's zip, install and enable it, without a splash screen."""
    (folder / "user").mkdir()
    path = build_zip(program, folder)
    program.run("--command", "extension", "install-file", "-r", "user_default", "--enable", path)
    quiet = "import bpy; bpy.context.preferences.view.show_splash = False; bpy.ops.wm.save_userpref()"
    program.run("-b", "--python-expr", quiet)
    lend_kernels(program.kernels)


if __name__ == "__main__":
    sys.exit(main())
