# SPDX-License-Identifier: GPL-3.0-or-later
"""Write docs/effects.md: what each effect declares, how it looks on the built-in island, and what it costs.

`make effects` runs it in the environment of the tests; every figure on the page is of that run.
"""

import io
import statistics
import sys
import tempfile
import time
from pathlib import Path

import matplotlib
import numpy as np
from adaptive_terrain.cbt_terrain.ask.criterion import Criterion
from adaptive_terrain.cbt_terrain.ask.view import View
from adaptive_terrain.cbt_terrain.effects.catalogue import EFFECTS
from adaptive_terrain.cbt_terrain.effects.effect import Asked, Effect, Places
from adaptive_terrain.cbt_terrain.effects.evaluate import Evaluator
from adaptive_terrain.cbt_terrain.effects.plan import plan
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.raster import ISLAND, ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.operators.output.exporting import write_files
from adaptive_terrain.operators.text.machine import machine
from adaptive_terrain.operators.text.numbers import plain
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
SIZE = 2049
EVERY = 8  # samples a picture's pixel
RUNS = 5
# What the button *Terrain Material* reads with its first settings, and six layers.
DEMANDED = "splat_1", "splat_2", "sky"
RESOLUTION = (1920, 1080)
EYE, TARGET = (-2500, -3900, 620), (300, 0, 560)  # as in the demo's flight
LAYERS = np.array([(0.76, 0.66, 0.42), (0.45, 0.62, 0.27), (0.55, 0.5, 0.47), (0.93, 0.95, 0.98)])
HEAD = """# Effects

Written by `make effects`; do not edit it by hand. Absolute times are of one machine on one day.

An effect is something that a material, a modifier or a map may read of a terrain: its slope, its layers, how
much sky it sees. **Only what is read is computed.** The extension looks which attributes your node trees read,
adds what those effects read themselves, and runs that, once. `adaptive-terrain effects --scene shot.blend` says
who reads what, and why the rest is skipped; so does the panel [Effects](manual.md#effects).
"""
SCALES = """## Two scales

* **For pictures** (materials, lights) a value is that of the ground at the size of a pixel: smoothed where it
  is far away, so that it does not flicker. The scale goes in steps of an eighth of an octave, so values stay
  bit for bit while the camera creeps.
* **For geometry** (modifiers, geometry nodes, exports) there is one scale in metres, the raster's own at first.
  So nothing moves with the camera. What both read has that scale.
"""
ADD = """## An effect of your own

One file: a function over arrays, a declaration, and an example that proves it. The example below is a whole
program, `examples/06_an_effect.py`, and is run as a test. To add an effect for good, put the function and the
declaration into a file of `cbt_terrain/effects/` and its name into the list of `catalogue.py`; the example is a
test from then on, and the panel, the command line and this page have it.

* A function of the place, the scale, its parameters and what it reads, and of nothing else. Asked for some
  places or for all, it gives the same values: only new vertices are asked for.
* Same bytes on any machine: no BLAS, no random numbers, no clock.
* Raise `version` whenever its values change.

```python
{code}```
"""


def main() -> int:
    try:
        with tempfile.TemporaryDirectory(prefix="adaptive-terrain-effects-") as folder:
            import_source(ImportSettings(source=ISLAND, size=SIZE), Path(folder) / "island")
            field = open_store(Path(folder) / "island")
            pictures = {f"effect_{name}.jpg": jpg(picture(name, field)) for name in EFFECTS}
            page = [HEAD, *saving(field), SCALES, "## All effects\n", *map(section, EFFECTS.values()), add_your_own()]
    except TerrainError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    write_files(DOCS / "images", pictures)
    write_files(DOCS, {"effects.md": "\n".join(page)})
    return 0


def jpg(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=88)
    return file.getvalue()


def add_your_own() -> str:
    code = (ROOT / "examples" / "06_an_effect.py").read_text(encoding="utf-8")
    return ADD.format(code=code.split("\n", 1)[1])  # without the licence's line


def section(effect: Effect) -> str:
    """An effect as its declaration has it, beside its picture."""
    facts = [f"**Unit** {effect.unit or 'none'}"]
    if effect.reads:
        facts.append(f"**Reads** {', '.join(f'[{name}](#{name})' for name in effect.reads)}")
    facts += [f"**Looks** {effect.halo}"] if effect.halo else []
    facts += [f"**Adds to the bound** {effect.bound or 'nothing'}", f"**Source** {effect.source}"]
    lines = [f"### {effect.name}\n", f"![{effect.about}](images/effect_{effect.name}.jpg)\n", f"{effect.about}.\n"]
    lines.append(" · ".join(facts) + "\n")
    numbers = [p for p in effect.parameters if isinstance(p.default, int | float)]
    if numbers:
        lines.append("| parameter | | | |\n| --- | ---: | --- | --- |")
        lines += [f"| `{p.name}` | {p.default:g} {p.unit} | {p.least:g} to {p.most:g} | {p.about} |" for p in numbers]
        lines.append("")
    return "\n".join(lines)


def saving(field) -> list[str]:
    """What one frame's effects take: each, those that the material reads, all."""
    view = View.look(EYE, TARGET, fov_deg=50, resolution=RESOLUTION, clip=(1, 100_000))
    terrain = Terrain(field)
    update = terrain.update(Criterion(error_px=1.0), [view])
    vertices = len(update.surface.positions)

    def ms_and_bytes(names, threads: int) -> tuple[float, int]:
        asked, times = plan([Asked(name, ("a material",)) for name in names]), []
        for _ in range(RUNS + 1):  # the first compiles, and makes what is kept of a field
            evaluator = Evaluator(threads)
            start = time.perf_counter()
            evaluator.attributes(asked, field, update.surface, [view])
            times.append((time.perf_counter() - start) * 1e3)
        return statistics.median(times[1:]), sum(ran.nbytes for ran in evaluator.ran.values())

    alone = {name: ms_and_bytes([name], 1) for name in EFFECTS}
    demanded = [name for name in DEMANDED if name in EFFECTS]
    (read_ms, read_bytes), (all_ms, all_bytes) = ms_and_bytes(demanded, 2), ms_and_bytes(list(EFFECTS), 2)
    text = (
        "## What it saves\n\n"
        f"One frame of the island, {SIZE:,} x {SIZE:,} samples, 1 pixel at {RESOLUTION[0]} x {RESOLUTION[1]}: "
        f"{vertices:,} vertices, none of them known from the frame before. The material of the button "
        f"*Terrain Material* reads {', '.join(f'`{name}`' for name in demanded)}.\n\n"
        "| | effects | ms, two threads | MB |\n| --- | ---: | ---: | ---: |\n"
        f"| nothing reads any | 0 | 0 | 0 |\n"
        f"| **what is read** | {len(plan([Asked(n, ()) for n in demanded]).steps)} | {plain(read_ms)} | "
        f"{plain(read_bytes / 1e6)} |\n"
        f"| everything | {len(EFFECTS)} | {plain(all_ms)} | {plain(all_bytes / 1e6)} |\n\n"
        "Of a flight's next frame only the new vertices are evaluated.\n\n"
        "Each alone, with what it reads, on one thread; *declared* is what its declaration says:\n\n"
        "| effect | ns a vertex | declared | bytes a vertex |\n| --- | ---: | ---: | ---: |"
    )
    rows = [
        f"| [{name}](#{name}) | {plain(1e6 * ms / vertices)} | {plain(EFFECTS[name].cost_ns)} | "
        f"{4 * EFFECTS[name].width} |"
        for name, (ms, _) in alone.items()
    ]
    where = ", ".join(machine()[key] for key in ("Processor", "System"))
    return [text, *rows, f"\nMeasured on {where}, {machine()['Threads']} threads.\n"]


def picture(name: str, field) -> np.ndarray:
    """The effect over the whole island as colours in a low sun: uint8 [rows, columns, 3], north on top."""
    places, rows = _grid(field)
    read: dict = {}
    for step in plan([Asked(name, ("this page",))]).steps:
        read |= EFFECTS[step.name].make(places, {step.name: EFFECTS[step.name].defaults()}, read)
    colour = colours(read[name].reshape(rows, rows, -1).astype(np.float64))
    heights = places.positions[:, 2].reshape(rows, rows).astype(np.float64)
    north, east = np.gradient(heights, field.lattice.step_x * EVERY)
    light = (0.6 * east - 0.5 * north + 0.62) / np.sqrt(1 + east**2 + north**2)
    shaded = colour * (0.55 + 0.55 * np.clip(light, 0, 1))[:, :, None]
    return (255 * np.clip(shaded, 0, 1) + 0.5).astype(np.uint8)[::-1]


def _grid(field) -> tuple[Places, int]:
    lattice = field.lattice
    west, south, east, north = lattice.rectangle()
    heights = field.heights(slice(None, None, EVERY), slice(None, None, EVERY))
    x, y = np.linspace(west, east, heights.shape[1]), np.linspace(south, north, heights.shape[0])
    positions = np.stack([*np.meshgrid(x, y), heights], -1).astype(np.float32).reshape(-1, 3)
    return Places(field, positions, np.full(len(positions), np.log2(EVERY), np.float32)), len(heights)


def colours(values: np.ndarray) -> np.ndarray:
    """float [rows, columns, width] -> float [rows, columns, 3]: a scale, a wheel, a direction or layers."""
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
    if low < 0 < high:  # both signs: white is 0
        most = max(-low, high)
        return matplotlib.colormaps["RdBu"](0.5 + 0.5 * values / most)[:, :, :3]
    if low > 0 and high > 100 * middle:  # spans decades
        values, low, high = np.log(values), np.log(low), np.log(high)
    return matplotlib.colormaps["viridis"]((values - low) / max(high - low, 1e-9))[:, :, :3]


if __name__ == "__main__":
    sys.exit(main())
