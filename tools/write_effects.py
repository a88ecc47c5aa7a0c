# SPDX-License-Identifier: GPL-3.0-or-later
"""Write docs/effects.md: the declaration, picture and cost of each effect on the built-in island.

`make effects` runs it in the environment of the tests; every figure on the page is of that run.
"""

import io
import json
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from adaptive_terrain.cbt_terrain.attributes.attribute import (
    LINEAR_RGB,
    AttributeRequest,
    SamplePoints,
)
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators.shape_process import shape_store
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ISLAND, ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.camera_path import read_camera_path
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.blender import need_bpy
from adaptive_terrain.operators.demo.demo import FLIGHT
from adaptive_terrain.operators.demo.stack import ISLAND_SEED, STACK
from adaptive_terrain.operators.export.exporting import write_files
from adaptive_terrain.operators.text.machine import describe_machine
from adaptive_terrain.operators.text.numbers import plain
from land_effects import jpg, land_section
from PIL import Image, ImageDraw, ImageFont

DOCS = Path(__file__).resolve().parents[1] / "docs"
SIZE = 2049
EVERY = 8  # samples a picture's pixel
RUNS = 3
RESOLUTION = (1920, 1080)
EYE, TARGET = (-3100, -1480, 840), (200, 0, 410)  # near the demo's frame
FRAME = 12
LETTERS = 20  # pixels, of a line below a picture
QUALITY = 88  # of JPEG files
WIDE = 1650  # pixels, of all pictures at a glance
LAYERS = np.array([(0.76, 0.66, 0.42), (0.45, 0.62, 0.27), (0.55, 0.5, 0.47), (0.93, 0.95, 0.98)])
HEAD = """# Effects

Written by `make effects`; do not edit it by hand. Absolute times are of one machine on one day.

An effect is something that a material, a modifier or a map may read of a terrain: its slope, its layers, how much sky
it sees. **Only effects that something reads are computed**, and each once. `adaptive-terrain effects --scene FILE` and
the panel [Attributes](reference/panel/attributes.md) list the readers of each effect and why the others are skipped.
"""
SCALES = """## Two scales

* **For pictures** (materials, lights) a value is that of the ground at the size of a pixel, so that it does not
  flicker far away. The scale has steps of an eighth of an octave, so values stay bit for bit while the camera creeps.
* **For geometry** (modifiers, geometry nodes, exports) there is one scale in metres, so nothing moves with the camera.
"""
CUSTOM_EFFECT = """## An effect of your own

[Architecture](architecture.md#add-an-attribute) lists the steps; `examples/06_an_effect.py` is a whole program, and a
test runs it. Values depend on the position, the scale, the parameters and the effects read, and on nothing else: no
BLAS, no random numbers, no clock. Raise `version` whenever they change.
"""
ALONE = ("color", "height", "sky", "splat_1")  # attributes whose pictures other pages show


def main() -> int:
    """Run the command line."""
    try:
        with tempfile.TemporaryDirectory(prefix="adaptive-terrain-effects-") as folder:
            import_source(ImportSettings(source=ISLAND, size=SIZE, seed=ISLAND_SEED), Path(folder) / "source")
            shape_store(Path(folder) / "source", STACK, Path(folder) / "island")
            field = open_store(Path(folder) / "island")
            demo = of_demo(Path(folder))
            drawn = {name: picture(name, field, demo.given) for name in ATTRIBUTES}
            pictures = {f"effect_{name}.jpg": jpg(pixels, QUALITY) for name, pixels in drawn.items() if pixels.any()}
            land, land_pictures = land_section()
            page = [HEAD, *saving(demo), *attribute_table(costs(field)), SCALES, *land, CUSTOM_EFFECT]
    except TerrainError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    shown = {f"effect_{name}.jpg": pictures[f"effect_{name}.jpg"] for name in ALONE}
    write_files(DOCS / "images", shown | land_pictures | {"effects.jpg": at_a_glance(pictures, demo.worn)})
    write_files(DOCS, {"effects.md": "\n".join(page)})
    return 0


def at_a_glance(pictures: dict[str, bytes], worn: set[str]) -> bytes:
    """Draw the island in its material next to all effects: those in `worn` in colour, unread ones in grey."""
    island = Image.open(DOCS / "images" / "land_whole.jpg").convert("RGB")
    columns, side, gap = 4, 150, 8
    rows = -(-len(ATTRIBUTES) // columns)
    high = rows * (side + LETTERS + gap)
    island = island.resize((high * island.width // island.height, high))
    sheet = Image.new("RGB", (island.width + gap + columns * (side + gap), high), (250, 249, 245))
    sheet.paste(island, (0, 0))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(matplotlib.get_data_path() + "/fonts/ttf/DejaVuSans.ttf", LETTERS - 5)
    for number, name in enumerate(ATTRIBUTES):
        x = island.width + gap + (number % columns) * (side + gap)
        y = number // columns * (side + LETTERS + gap)
        if f"effect_{name}.jpg" not in pictures:
            continue
        tile = Image.open(io.BytesIO(pictures[f"effect_{name}.jpg"])).resize((side, side))
        if name not in worn:
            tile = Image.blend(tile.convert("L").convert("RGB"), Image.new("RGB", tile.size, (250, 249, 245)), 0.6)
        sheet.paste(tile, (x, y))
        draw.text((x, y + side + 1), name, fill=(28, 31, 38) if name in worn else (160, 160, 160), font=font)
    sheet = sheet.resize((WIDE, WIDE * sheet.height // sheet.width), Image.Resampling.LANCZOS)
    return jpg(np.asarray(sheet), QUALITY)


@dataclass(frozen=True)
class Demo:
    """A frame of the demo.

    `read` and `everything`: number, milliseconds and bytes of the effects that the material reads, and of all effects.
    `worn`: the effects that the material reads as attributes and as maps, with their inputs. `given`: the layers of the
    ground and their colours, as parameters of effects.
    """

    read: tuple[int, float, int]
    everything: tuple[int, float, int]
    vertices: int
    worn: set[str]
    given: dict


def saving(demo: Demo) -> list[str]:
    """Return the time of the demo's frame for its material and for all effects."""
    rows = [("nothing reads any", 0, 0.0, 0), ("**the material**", *demo.read)]
    rows.append(("everything", *demo.everything))
    machine = describe_machine()
    return [
        "## What it saves\n",
        f"Frame {FRAME} of the demo: the island, {SIZE:,} x {SIZE:,} samples, at 1 pixel of {RESOLUTION[0]} x "
        f"{RESOLUTION[1]}; {demo.vertices:,} vertices, none of them known from the frame before. Measured on "
        f"{machine['Processor']}, {machine['System']}, {machine['Threads']} threads.\n",
        "| | effects | ms | MB |\n| --- | ---: | ---: | ---: |",
        *(f"| {what} | {count} | {plain(ms)} | {plain(size / 1e6)} |" for what, count, ms, size in rows),
        "",
    ]


def costs(field) -> dict[str, float]:
    """Return the nanoseconds a vertex of each effect and its inputs, on one thread."""
    view = View.look(EYE, TARGET, fov_deg=50, resolution=RESOLUTION, clip=(1, 100_000))
    surface = Terrain(field).update(Criterion(error_px=1.0), [view]).surface
    return {name: 1e6 * alone(name, field, surface, view) / len(surface.positions) for name in ATTRIBUTES}


def attribute_table(ns: dict[str, float]) -> list[str]:
    """Return the table of all effects with their costs, below their pictures."""
    lines = [
        "## All effects\n",
        "![The island and its attributes; the coloured ones are read by the demo's material](images/effects.jpg)\n",
        "The time is of each alone, with the effects that it reads, on one thread; *declared* is the cost in its "
        "declaration. No effect adds to the bound.\n",
        "| effect | meaning | unit | reads | ns a vertex | declared | source |",
        "| --- | --- | --- | --- | ---: | ---: | --- |",
    ]
    for name, effect in ATTRIBUTES.items():
        cells = [f"`{name}`", effect.about, effect.unit, ", ".join(effect.reads_with(()))]
        cells += [plain(ns[name]), plain(effect.cost_ns), effect.source]
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def of_demo(folder: Path) -> Demo:
    """Measure the demo's frame."""
    need_bpy("The demo")
    from adaptive_terrain.operators.demo import scene as demo_scene
    from adaptive_terrain.operators.layers.properties import color_parameters
    from adaptive_terrain.operators.session import session

    (folder / "flight.json").write_text(json.dumps(FLIGHT), encoding="utf-8")
    flight = read_camera_path(folder / "flight.json")
    criterion, frames = Criterion(error_px=1.0), range(FRAME, FRAME + 1)
    _, obj = demo_scene.build(folder, folder / "island", flight, frames, RESOLUTION, criterion)

    def measure() -> tuple[int, float, int]:
        times = []
        for _ in range(RUNS + 1):  # the first fills the caches of the field
            session.record_of(obj).terrain = None  # nothing is known from before
            session.update_object(obj)
            computed = [status for status in session.record_of(obj).status.effects.values() if not status.skipped]
            times.append(sum(status.ms for status in computed))
        return len(computed), statistics.median(times[1:]), sum(status.nbytes for status in computed)

    read = measure()
    statuses = session.record_of(obj).status.effects
    worn = {step.name for step in plan([AttributeRequest(name, ()) for name in demo_scene.MAPS]).steps}
    worn |= {name for name, status in statuses.items() if not status.skipped}
    for name in ATTRIBUTES:
        getattr(obj.adaptive_terrain.effects, name).when = "PINNED"
    return Demo(read, measure(), len(obj.data.vertices), worn, color_parameters(obj.adaptive_terrain))


def alone(name: str, field, surface, view: View) -> float:
    """Return the milliseconds of an effect and its inputs on one thread."""
    planned, times = plan([AttributeRequest(name, ("a material",))]), []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        evaluate(field, EffectRequest(planned, surface, [view]), FrameHistory())
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times[1:])


def picture(name: str, field, given: dict) -> np.ndarray:
    """Draw an effect over the whole island as colours in low sun: uint8 [rows, columns, 3], north at the top."""
    places, rows = _grid(field)
    read: dict = {}
    parameters = tuple(item for item in given.items() if item[0] in ATTRIBUTES[name].defaults())
    for step in plan([AttributeRequest(name, ("this page",), parameters=parameters)]).steps:
        values = ATTRIBUTES[step.name].defaults() | dict(step.parameters)
        read |= ATTRIBUTES[step.name].make(places, {step.name: values}, read)
    values = read[name].reshape(rows, rows, -1).astype(np.float64)
    colour = values ** (1 / 2.2) if ATTRIBUTES[name].unit == LINEAR_RGB else colours(values)
    heights = places.positions[:, 2].reshape(rows, rows).astype(np.float64)
    north, east = np.gradient(heights, field.lattice.step_x * EVERY)
    light = (0.6 * east - 0.5 * north + 0.62) / np.sqrt(1 + east**2 + north**2)
    shaded = colour * (0.55 + 0.55 * np.clip(light, 0, 1))[:, :, None]
    return (255 * np.clip(shaded, 0, 1) + 0.5).astype(np.uint8)[::-1]


def _grid(field) -> tuple[SamplePoints, int]:
    lattice = field.lattice
    west, south, east, north = lattice.rectangle()
    heights = field.heights(slice(None, None, EVERY), slice(None, None, EVERY))
    x, y = np.linspace(west, east, heights.shape[1]), np.linspace(south, north, heights.shape[0])
    positions = np.stack([*np.meshgrid(x, y), heights], -1).astype(np.float32).reshape(-1, 3)
    return SamplePoints(field, positions, np.full(len(positions), np.log2(EVERY), np.float32)), len(heights)


def colours(values: np.ndarray) -> np.ndarray:
    """Float [rows, columns, width] -> float [rows, columns, 3]: a scale, a wheel, a direction or layers."""
    width = values.shape[2]
    if width == 1:
        return _scale(values[:, :, 0])
    if width == 2:  # sine and cosine
        turn = np.arctan2(values[:, :, 0], values[:, :, 1]) / (2 * np.pi) % 1.0
        return matplotlib.colormaps["twilight_shifted"](turn)[:, :, :3]
    if width == 3:
        return 0.5 + 0.5 * values
    return (np.clip(values, 0, None)[:, :, :, None] * LAYERS).sum(2)


def _scale(values: np.ndarray) -> np.ndarray:
    low, middle, high = np.percentile(values, (2, 50, 98))
    high = high if high > low else values.max()  # a layer that covers few places
    if low < 0 < high:  # both signs: white is 0
        largest = max(-low, high)
        return matplotlib.colormaps["RdBu"](0.5 + 0.5 * values / largest)[:, :, :3]
    if low > 0 and high > 100 * middle:  # spans decades
        values, low, high = np.log(values), np.log(low), np.log(high)
    return matplotlib.colormaps["viridis"]((values - low) / max(high - low, 1e-9))[:, :, :3]


if __name__ == "__main__":
    sys.exit(main())
