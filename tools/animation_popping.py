# SPDX-License-Identifier: GPL-3.0-or-later
"""How far points of the ground jump from one frame to the next, with geomorph and without.

Their shading and other errors: docs/accuracy.md.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.accuracy.measure import look, popping
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.text.log_plot import Curve, draw
from adaptive_terrain.operators.text.page_blocks import Heading, Plot, Table, Text
from adaptive_terrain.operators.text.svg import BLUE, GREEN, RED
from write_accuracy import jacksboro

RESOLUTION = (960, 540)
ERROR_PX = 1.0
FRAMES = 6  # of a flight at each speed
STEPS = (16.0, 8.0, 4.0, 2.0, 1.0)  # metres of the camera between frames
LONG, LONG_STEP = 30, 2.0  # frames of the long flight, and its metres a frame


@dataclass(frozen=True)
class FlownGround:
    """A height field and a straight flight over it, metres: the camera is at `eye` when it has flown 0."""

    name: str
    colour: str
    field: HeightField
    eye: tuple[float, float, float]
    heading: tuple[float, float, float]

    def view(self, flown: float) -> View:
        """Return the view after `flown` metres."""
        eye = np.add(self.eye, np.multiply(self.heading, flown))
        ahead = np.array([self.heading[0], self.heading[1], -0.18])
        return View.look(eye, eye + 1000.0 * ahead, fov_deg=50, resolution=RESOLUTION, clip=(1.0, 1e6))


@dataclass(frozen=True)
class Flight:
    """Measurements of a flight.

    Per pair of frames: the largest jump and its 99.9th percentile in pixels. Also the triangles of its frames.
    """

    largest_px: list[float]
    p999: list[float]
    triangles: float


def grounds(folder: Path) -> list[FlownGround]:
    """Return the island, dunes and the real elevation model."""
    built = []
    for name, colour, settings, over in (
        ("the island", RED, ImportSettings(source="island", size=2049), 320.0),
        ("dunes", GREEN, ImportSettings(source="dunes", size=2049), 60.0),
        ("the Jacksboro fault", BLUE, jacksboro(folder), 500.0),
    ):
        store = folder / f"{len(built)}.store"
        import_source(settings, store)
        field = open_store(store)
        west, south, x, y = field.lattice.rectangle()
        eye = 0.3 * west, 0.5 * south, field.max_height * 0.5 + field.min_height * 0.5 + over
        aim = np.array([-eye[0], -eye[1]]) / math.hypot(eye[0], eye[1])
        built.append(FlownGround(name, colour, field, eye, (float(aim[0]), float(aim[1]), 0.0)))
    return built


def fly(ground: FlownGround, step: float, frames: int, morph: float) -> Flight:
    """Fly over a ground and measure how far points jump between frames."""
    terrain, before = Terrain(ground.field), None
    largest_px, p999, triangles = [], [], []
    for number in range(frames):
        view = ground.view(number * step)
        update = terrain.update(Criterion(error_px=ERROR_PX, morph=morph), [view])
        after = update.surface.copy()
        if before is not None:
            jumps = popping(before, after, look(ground.field, view))
            largest_px.append(jumps.max)
            p999.append(jumps.p999)
        before = after
        triangles.append(update.triangles)
    return Flight(largest_px, p999, sum(triangles) / len(triangles))


def slope(flights: dict[float, Flight]) -> float:
    """Return the slope of log jump against log camera step, by least squares."""
    x = np.log(list(flights))
    y = np.log([max(flight.largest_px) for flight in flights.values()])
    x -= x.mean()
    return float((x * (y - y.mean())).sum() / (x * x).sum())


def popping_section(folder: Path) -> list:
    """Return the section about points that pop."""
    rows, curves = [], []
    for ground in grounds(folder):
        rough, smooth = ({step: fly(ground, step, FRAMES, morph) for step in STEPS} for morph in (1.0, SMOOTH))
        for flights, how, dash in ((rough, "without", "7 4"), (smooth, "smooth", "")):
            points = [(step, max(flight.largest_px)) for step, flight in flights.items()]
            curves.append(Curve(f"{ground.name}, {how}", ground.colour, points, dash))
        long = [fly(ground, LONG_STEP, LONG, morph) for morph in (1.0, SMOOTH)]
        rows.append(
            [
                ground.name,
                *(f"{max(flight.largest_px):.3g}" for flight in long),
                *(f"{max(flight.p999):.3g}" for flight in long),
                f"{slope(rough):.2f}",
                f"{slope(smooth):.2f}",
                f"{long[1].triangles / long[0].triangles:.2f}",
            ]
        )
        print(rows[-1], flush=True)
    head = ["", *(word for kind in ("largest jump", "p99.9", "slope") for word in (f"{kind}, without", "smooth"))]
    drawn = draw(curves, "the camera's step, metres a frame", "largest jump, px")
    return [
        Heading("No pop"),
        Text(
            "A vertex pops when it is added, by up to the tolerance: a small jump, but thousands of points jump in "
            "every frame. With *Geomorph* (on in renders) a point enters where it changes nothing, and rises to its "
            "place as the camera comes nearer. How far it has risen depends on the view alone. So any frame can be "
            "rendered alone, in any order. The tolerance still holds: the surface is a mean of meshes of which each "
            "holds it ([the proof](method/morph.md))."
        ),
        Text(
            f"Measured over {LONG} frames, {LONG_STEP:g} m a frame, at {ERROR_PX:g} px and {RESOLUTION[0]} x "
            f"{RESOLUTION[1]} pixels: how far points of the ground move on the screen where one frame's mesh takes the "
            "place of the last one's, in pixels. The slope says how the largest jump follows the camera's step: 1 is "
            "half the jump for half the step, 0 is a jump however slow the camera."
        ),
        Table([*head, "triangles ×"], rows),
        Plot("images/animation_steps.svg", "The largest jump against the camera's step.", drawn),
    ]
