# SPDX-License-Identifier: GPL-3.0-or-later
"""Write docs/accuracy.md and its plots: the built-in island and a real elevation model, imported and measured here.

`make accuracy` runs it in the environment of the tests; every figure on the page is of that run.
"""

import json
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.accuracy.timed_runs import TimedFrame
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ISLAND, ImportSettings
from adaptive_terrain.cbt_terrain.view.camera_path import read_camera_path
from adaptive_terrain.operators.accuracy import page as accuracy_page
from adaptive_terrain.operators.accuracy import report as accuracy_report
from adaptive_terrain.operators.accuracy.subject import AccuracySubject, store_subject
from adaptive_terrain.operators.accuracy.transitions_section import transitions_section
from adaptive_terrain.operators.cli import accuracy_command
from adaptive_terrain.operators.demo.demo import FLIGHT
from adaptive_terrain.operators.export.exporting import write_files, write_text
from adaptive_terrain.operators.text.console import Progress
from adaptive_terrain.operators.text.machine import describe_machine
from adaptive_terrain.operators.text.page_blocks import Heading, Text, as_markdown
from matplotlib.cbook import get_sample_data

ISLAND_SIZE = 2049
RESOLUTION = (1920, 1080)
# Of the demo's flight: at the start, near the ground, near its end; popping is towards STEP of a frame after each. The
# flight crosses an island in 24 frames: as a second each, they are a flight of 320 m/s, 24 frames a second.
FRAMES = (1, 12, 23)
STEP = 1 / 24
FLIGHT_NOTE = "Popping is that of a flight of 24 frames where the demo has one, 13 m a frame."
MODEL = "jacksboro"
MODEL_NOTE = "The elevation model is the Jacksboro fault, SRTM at 3 arc seconds, as matplotlib ships it."
DOCS = Path(__file__).resolve().parents[1] / "docs"
PLOTS = "images/accuracy_"
METRES_PER_DEGREE = 111_320.0
INTRODUCTION = (
    "Written by `make accuracy`; do not edit it by hand. `adaptive-terrain accuracy --store DIR --out DIR` writes such "
    "a page of any terrain, with tables of every setting, as HTML, CSV and JSON too ([its "
    "options](reference/commands/accuracy.md)). Absolute times are of one machine on one day."
)


def main() -> int:
    """Run the command line."""
    try:
        with tempfile.TemporaryDirectory(prefix="adaptive-terrain-accuracy-") as folder:
            subjects = [subject_of(name, settings, Path(folder)) for name, settings in sources(Path(folder)).items()]
            next(subject for subject in subjects if subject.name == MODEL).notes.append(MODEL_NOTE)
            accuracy_command.measure(subjects)
            write(subjects)
    except TerrainError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def sources(folder: Path) -> dict[str, ImportSettings]:
    """Return the rasters to measure by the name of their section."""
    return {ISLAND: ImportSettings(source=ISLAND, size=ISLAND_SIZE), MODEL: jacksboro(folder)}


def jacksboro(folder: Path) -> ImportSettings:
    """Write the real elevation model into a folder."""
    model = get_sample_data("jacksboro_fault_dem.npz")
    np.save(folder / "jacksboro.npy", model["elevation"])
    rows, columns = model["elevation"].shape
    north, east = METRES_PER_DEGREE, METRES_PER_DEGREE * math.cos(math.radians((model["ymin"] + model["ymax"]) / 2))
    extent = float((columns - 1) * model["dx"] * east), float((rows - 1) * model["dy"] * north)
    return ImportSettings(source=str(folder / "jacksboro.npy"), extent=extent)


def subject_of(name: str, settings: ImportSettings, folder: Path) -> AccuracySubject:
    """Import a raster; return it as a subject of the page."""
    with Progress(1.0, f"import {name}") as bar:
        import_source(settings, folder / f"{name}.store", on_progress=lambda fraction, message: bar.to(fraction))
    if name != ISLAND:
        return store_subject(folder / f"{name}.store", None, None, RESOLUTION)
    flight = folder / "flight.json"
    flight.write_text(json.dumps(FLIGHT), encoding="utf-8")
    subject = store_subject(folder / f"{name}.store", flight, FRAMES, RESOLUTION)
    path = read_camera_path(flight)
    after = [TimedFrame([path.view(number + STEP, RESOLUTION)]) for number in FRAMES]
    subject.frames = [replace(frame, after=next_) for frame, next_ in zip(subject.frames, after, strict=True)]
    subject.notes.append(FLIGHT_NOTE)
    subject.seen = f"along the demo's flight, {RESOLUTION[0]} x {RESOLUTION[1]} pixels"
    return subject


def write(subjects: list[AccuracySubject]) -> None:
    """Write the page without its tables, its plots and its pictures."""
    blocks: list = [Text(INTRODUCTION)]
    for subject in subjects:
        blocks += [Heading(subject.title), *accuracy_page.front_blocks(subject, PLOTS)]
        blocks += transitions_section(subject.rows, f" of {subject.title}", f"{PLOTS}{subject.name}_popping.svg")
    blocks.append(accuracy_page.measured_on(describe_machine()))
    write_files(DOCS, accuracy_page.pictures(blocks))
    write_text(DOCS / "accuracy.md", as_markdown(accuracy_page.TITLE, blocks))
    accuracy_report.check_bounds(subjects)


if __name__ == "__main__":
    sys.exit(main())
