# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of docs/effects.md that is about effects on heights and about built-in lands: pictures, and what they cost.

write_effects.py asks for it. Every figure is measured on the built-in island, in the run that writes the page.
"""

import io
import math
import time
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from adaptive_terrain.cbt_terrain.attributes.attribute import Parameter
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.lands import LANDS, BuiltInTerrain
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.shape import shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack, read_stack
from adaptive_terrain.cbt_terrain.height_operators.tiles import whole_land
from adaptive_terrain.operators.text.numbers import plain
from PIL import Image, ImageDraw, ImageFont

PRESETS = Path(__file__).resolve().parents[1] / "operators" / "presets" / "adaptive_terrain" / "land"
SIZE = 1025
WIDE = 480  # pixels, of each half of a picture
GAP, LETTERS = 8, 20  # pixels between pictures of a sheet, and of the line below one
# What is shown of each effect: parameters that differ, the part of the island that is looked at (west, south, side, of
# 1), and what of its layers is drawn over the ground.
SHOWN: dict[str, tuple[dict, tuple[float, float, float], str]] = {
    "rivers": ({"years": 4e5}, (0.05, 0.05, 0.9), ""),
    "scree": ({}, (0.4, 0.36, 0.3), "scree"),
    "relief": ({"wave": 128.0, "beds": 60.0}, (0.44, 0.4, 0.2), ""),
    "snow": ({"line": 450.0}, (0.25, 0.2, 0.6), "snow"),
    "water": ({}, (0.1, 0.3, 0.5), "water_depth"),
    "flood": ({"minutes": 15.0, "rain": 200.0}, (0.1, 0.3, 0.5), "water_depth"),
}
WHOLE = (0.0, 0.0, 1.0)
TINTS = {"scree": (0.72, 0.66, 0.58), "snow": (0.97, 0.98, 1.0), "water_depth": (0.16, 0.42, 0.6)}
FULL = {"scree": 12.0, "snow": 0.6, "water_depth": 0.8}  # metres of a layer that hide the ground
LAND_RAMP = (
    (0.0, (0.80, 0.74, 0.58)),
    (0.04, (0.42, 0.47, 0.27)),
    (0.5, (0.40, 0.42, 0.28)),
    (1.0, (0.60, 0.55, 0.49)),
)
SAND = ((0.0, (0.80, 0.63, 0.42)), (1.0, (0.90, 0.77, 0.58)))
ROCK = ((0.0, (0.45, 0.36, 0.28)), (0.3, (0.67, 0.40, 0.27)), (0.8, (0.82, 0.66, 0.50)), (1.0, (0.56, 0.55, 0.38)))
MEADOWS = ((0.0, (0.38, 0.44, 0.26)), (0.4, (0.42, 0.44, 0.29)), (1.0, (0.58, 0.55, 0.50)))
RAMPS = {"dunes": SAND, "canyon": ROCK, "mountains": MEADOWS}
SEAS = ("island", "archipelago")
HEAD = """## Effects that shape the land

These change heights: a stack of them makes a second store next to the source's, level by level and only for the tiles
that a shot sees finer than that. Their by-products (depth of scree, snow, water, wear) are layers for materials.
`adaptive-terrain shape --store DIR --stack FILE.json --out DIR` applies a stack, and so does the panel Land.

* **The number of samples decides where valleys lie.** Twice as many cells along a side add detail to the same land.
  Any other number moves the samples of the coarse levels, where valleys are chosen: on the built-in island 1,030
  samples a side instead of 1,025 change the heights by 0.26 m rms before the demo's stack and by 49 m rms after it.
* **The border of a raster is open.** Streams and droplets carry material over it, and nothing comes in.

![Each effect on the built-in island, before and after](images/land_effects.jpg)

Each measured on the island, {size:,} x {size:,} samples {step:g} m apart, all levels, one thread. *Finer by one level*:
root mean square of the change by the last halving of the spacing, at the samples that both have; *s*: of the processor.

| effect | changes heights by, rms | finer by one level | s | microseconds a sample |
| --- | ---: | ---: | ---: | ---: |
"""
LANDS_HEAD = """## Built-in lands

`adaptive-terrain import NAME --size N --seed S --store DIR` makes one at any resolution, from no file: a place has the
same height at every resolution and the same bytes on every machine. On the right: with the preset stack that suits it.

![The built-in lands, as imported and with their presets](images/lands.jpg)
"""
# Pictures that other pages show alone.
ALONE = ("land_rivers", "land_relief", "land_snow", "land_of_mountains", "land_of_archipelago")


@dataclass(frozen=True)
class Shown:
    """An effect or a stack on a land.

    Heights before and after and layers are float32 [rows, columns]; then metres between samples and processor seconds.
    """

    before: np.ndarray
    after: np.ndarray
    layers: dict[str, np.ndarray]
    step: float
    seconds: float


def land_section() -> tuple[list[str], dict[str, bytes]]:
    """Return the lines of the page and its pictures by file name."""
    pictures, costs = {}, {}
    for effect in HEIGHT_OPERATORS.values():
        parameters, part, layer = SHOWN.get(effect.name, ({}, WHOLE, ""))
        stack = Stack((Entry(effect.name, parameters),))
        coarse, shown = (shaped(LANDS["island"], size, stack) for size in (SIZE // 2 + 1, SIZE))
        change = shown.after - shown.before
        finer = rms(change[::2, ::2] - (coarse.after - coarse.before))
        moved = f"{plain(rms(change))} m | {plain(finer)} m" if change.any() else "not: its layers say it | -"
        costs[effect.name] = f"{moved} | {plain(shown.seconds)} | {plain(shown.seconds * 1e6 / change.size)}"
        pictures[f"land_{effect.name}.jpg"] = beside(shown, part, layer, LAND_RAMP, True)
    for land in LANDS.values():
        entries = read_stack(PRESETS / f"{land.preset}.json") if land.preset else Stack()
        shown = shaped(land, SIZE, entries)
        layer = next((name for name in ("snow", "water_depth") if name in shown.layers), "")
        ramp = RAMPS.get(land.name, LAND_RAMP)
        pictures[f"land_of_{land.name}.jpg"] = beside(shown, WHOLE, layer, ramp, land.name in SEAS)
    sheets = {
        "land_effects.jpg": sheet({name: pictures[f"land_{name}.jpg"] for name in HEIGHT_OPERATORS}),
        "lands.jpg": sheet({name: pictures[f"land_of_{name}.jpg"] for name in LANDS}),
    }
    shown_alone = {f"{name}.jpg": pictures[f"{name}.jpg"] for name in ALONE}
    return [*operator_lines(costs), *land_lines()], shown_alone | sheets


def sheet(pictures: dict[str, bytes]) -> bytes:
    """Return a JPEG of pictures in two columns, each above its name."""
    tiles = [Image.open(io.BytesIO(picture)) for picture in pictures.values()]
    width, height = (max(tile.size[axis] for tile in tiles) * 3 // 4 for axis in (0, 1))
    whole = Image.new("RGB", (2 * width + GAP, -(-len(tiles) // 2) * (height + LETTERS + GAP)), (250, 249, 245))
    font = ImageFont.truetype(matplotlib.get_data_path() + "/fonts/ttf/DejaVuSans.ttf", LETTERS - 5)
    for number, (name, tile) in enumerate(zip(pictures, tiles, strict=True)):
        x, y = number % 2 * (width + GAP), number // 2 * (height + LETTERS + GAP)
        whole.paste(tile.resize((width, height), Image.Resampling.LANCZOS), (x, y))
        ImageDraw.Draw(whole).text((x, y + height + 1), name, fill=(28, 31, 38), font=font)
    return jpg(np.asarray(whole), quality=86)


def jpg(pixels: np.ndarray, quality: int) -> bytes:
    """Return pixels, uint8 [rows, columns, 3], as a JPEG file. quality: 1 to 95."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return file.getvalue()


def operator_lines(costs: dict[str, str]) -> list[str]:
    """Return the text on all height operators. `costs`: the last four cells of each operator's row."""
    operators = HEIGHT_OPERATORS.values()
    lines = [HEAD.format(size=SIZE, step=LANDS["island"].side / (SIZE - 1)).rstrip()]
    lines += [f"| `{effect.name}` | {costs[effect.name]} |" for effect in operators]
    lines.append("")
    for effect in operators:
        drawn = ", ".join(f"{name} {plain(value)}" for name, value in SHOWN.get(effect.name, ({},))[0].items())
        halo = effect.halo(effect.defaults(), 1.0)
        facts = {
            "Shown with": drawn,
            "Limit:": effect.limit,
            "Conserves:": effect.conserves,
            "Converges:": effect.converges,
            "Looks": "at the whole raster" if math.isinf(halo) else f"{plain(halo)} m around a tile of 1 m",
            "Source:": effect.source,
            "Parameters": ", ".join(map(parameter_text, effect.parameters)),
        }
        text = "; ".join(f"*{name}* {fact}" for name, fact in facts.items() if fact)
        lines.append(f"* **{effect.label}** (`{effect.name}`). {effect.about}. {text}.")
    return [*lines, ""]


def parameter_text(p: Parameter) -> str:
    """Return a parameter's name, default, unit and range."""
    return f"`{p.name}` {f'{p.default:g} {p.unit}'.rstrip()} ({p.min:g} to {p.max:g})"


def land_lines() -> list[str]:
    """Return the text on the built-in lands."""
    lines = [LANDS_HEAD]
    for land in LANDS.values():
        suits = f"; preset *{land.preset.replace('_', ' ')}*" if land.preset else ""
        lines.append(
            f"* **{land.name}**: {land.about[0].lower()}{land.about[1:]}. {land.side / 1e3:g} km a side{suits}."
        )
    return [*lines, ""]


def shaped(land: BuiltInTerrain, size: int, stack: Stack) -> Shown:
    """Apply a stack to a whole land in memory."""
    heights, step = land.heights(size), land.side / (size - 1)
    field = from_array(heights, step)
    start = time.process_time()
    shaped = shape(field, stack, whole_land(field.lattice))
    seconds = time.process_time() - start
    return Shown(heights, heights + shaped.change, shaped.layers, step, seconds)


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square."""
    return math.sqrt(float(np.mean(np.square(values, dtype=np.float64))))


def beside(shown: Shown, part: tuple[float, float, float], layer: str, ramp: tuple, sea: bool) -> bytes:
    """Return a JPEG of the ground before and after, in low sun from the north-west, north at the top."""
    count = shown.before.shape[0]
    west, south, side = (round(p * (count - 1)) for p in part)
    cut = np.s_[south : south + side + 1, west : west + side + 1]
    land = shown.before[shown.before > 0.0] if sea else shown.before
    limits = float(np.percentile(land, 1)), float(max(shown.before.max(), shown.after.max()))
    halves = [shaded(h[cut], shown.step, ramp, limits, sea) for h in (shown.before, shown.after)]
    if layer in shown.layers:
        depth = shown.layers[layer][cut]
        dry = (shown.after[cut] > 0.0) if sea and layer == "water_depth" else np.ones(depth.shape, bool)
        cover = (np.clip(depth / FULL[layer], 0.0, 1.0) * dry)[:, :, None]
        tint = shaded(shown.after[cut], shown.step, ((0.0, TINTS[layer]), (1.0, TINTS[layer])), limits, False)
        halves[1] = halves[1] * (1.0 - cover) + tint * cover
    gap = np.ones((WIDE, 6, 3))
    pixels = [_resized(half[::-1]) for half in halves]
    picture = (255 * np.clip(np.concatenate([pixels[0], gap, pixels[1]], axis=1), 0, 1) + 0.5).astype(np.uint8)
    return jpg(picture, quality=86)


def _resized(pixels: np.ndarray) -> np.ndarray:
    image = Image.fromarray((255 * np.clip(pixels, 0, 1) + 0.5).astype(np.uint8))
    return np.asarray(image.resize((WIDE, WIDE), Image.Resampling.LANCZOS), np.float64) / 255


def shaded(heights: np.ndarray, step: float, ramp: tuple, limits: tuple[float, float], sea: bool) -> np.ndarray:
    """float64 [rows, columns, 3]: the ramp's colours by height, in sun and sky; the sea by its depth."""
    h = heights.astype(np.float64)
    north, east = np.gradient(h, step)
    length = np.sqrt(1 + east**2 + north**2)
    sun = np.clip((0.56 * east - 0.56 * north + 0.62) / length, 0, 1)[:, :, None]
    sky = (0.5 + 0.5 / length)[:, :, None]
    at = (h - limits[0]) / max(limits[1] - limits[0], 1e-9)
    places, colours = [place for place, _ in ramp], np.array([colour for _, colour in ramp])
    ground = np.stack([np.interp(at, places, colours[:, k]) for k in range(3)], -1)
    lit = ground * (1.25 * sun * np.array([1.0, 0.95, 0.86]) + 0.36 * sky * np.array([0.8, 0.9, 1.1]))
    if not sea:
        return lit
    deep = np.clip(-h / 120.0, 0, 1)[:, :, None]
    water = np.array([0.26, 0.52, 0.58]) * (1 - deep) + np.array([0.08, 0.2, 0.34]) * deep
    return np.where(h[:, :, None] <= 0.0, water, lit)
