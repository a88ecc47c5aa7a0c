# SPDX-License-Identifier: GPL-3.0-or-later
"""Scripts in a window of the real program: pictures of the screen, and their reports."""

import json
import os
from pathlib import Path

from program_window import read_screen, wait_for, window
from real_program import SCRIPTS


def run_in_window(program, script: str, folder: Path, moments: tuple[str, ...] = (), **options) -> dict:
    """Run a script in a window, save a picture of the screen at each moment and at the end, and return its report.

    The script creates FOLDER/MOMENT, waits for FOLDER/MOMENT_pictured, and writes FOLDER/done.json at its end.
    """
    pictures = Path(os.environ.get("ADAPTIVE_TERRAIN_PICTURES", folder))
    pictures.mkdir(parents=True, exist_ok=True)
    arguments, done = ["--python", str(SCRIPTS / script), "--", str(folder)], folder / "done.json"
    with window(program, arguments, folder, **options) as blender:
        try:
            for moment in moments:
                wait_for(folder / moment, blender, ended=done)
                read_screen(folder).save(pictures / f"{moment}.png")
                (folder / f"{moment}_pictured").touch()
            wait_for(done, blender)
        finally:
            read_screen(folder).save(pictures / f"{Path(script).stem}_end.png")
    report = json.loads(done.read_text())
    assert "error" not in report, (report, (folder / "blender.log").read_text()[-4000:])
    return report
