# SPDX-License-Identifier: GPL-3.0-or-later
"""Take the pictures of the panel for docs/images in the real Blender program: `take_screenshots.py WRAPPER`.

WRAPPER is `.cache/blender.run`, written by tools/get_blender.sh. The script needs root and some minutes: it builds the
extension and installs it into a folder that is removed at the end.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

import numpy as np  # noqa: E402
import program_window  # noqa: E402
from real_program import Program, lend_kernels, read_dem, write_dem  # noqa: E402

PICTURES = {"first_import": (1200, 800), "panel": (1320, 1300)}


def main() -> int:
    """Run the command line."""
    with tempfile.TemporaryDirectory(prefix="screenshots-", dir="/tmp") as name:
        folder = Path(name)
        program = Program(str(Path(sys.argv[1]).resolve()), folder / "user")
        install(program, folder)
        model = folder / "valley.tif"
        write_dem(model, read_dem()["elevation"].astype(np.float32))
        script = ROOT / "tools" / "screenshot_scenes.py"
        for picture, size in PICTURES.items():
            program_window.SCREEN = size
            arguments = ["--python", script, "--", picture, folder, model]
            with program_window.window(program, arguments, folder, place=(0, 0, *size)) as blender:
                program_window.wait_for(folder / f"{picture}.ready", blender)
                screen = program_window.read_screen(folder)
            screen.save(ROOT / "docs" / "images" / f"{picture}.jpg", quality=88)
    return 0


def install(program: Program, folder: Path) -> None:
    """Build the extension's zip, install and enable it, without a splash screen."""
    (folder / "user").mkdir()
    command = [sys.executable, ROOT / "tools" / "build_extension.py", "--output", folder]
    command += ["--blender", *program.command()]
    subprocess.run(command, check=True, cwd=ROOT, env=program.environment())
    [path] = folder.glob("*.zip")
    program.run("--command", "extension", "install-file", "-r", "user_default", "--enable", path)
    quiet = "import bpy; bpy.context.preferences.view.show_splash = False; bpy.ops.wm.save_userpref()"
    program.run("-b", "--python-expr", quiet)
    lend_kernels(program.kernels)


if __name__ == "__main__":
    sys.exit(main())
