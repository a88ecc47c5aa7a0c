# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's page: one HTML file with pictures and the figures of its run."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.accuracy.crops import Crop
from ..export.exporting import write_text
from ..text.numbers import plain
from ..text.page_blocks import (
    Code,
    Figures,
    Heading,
    Lead,
    PagePicture,
    PictureStrip,
    Plot,
    Table,
    Text,
    Words,
    as_html,
)
from ..text.png import png
from ..text.shown_bounds import bound_text
from ..text.svg import RED, TEAL, box, path, picture, text

TITLE = "An island, seen from the air"
READ = """import numpy as np
mesh = np.load("meshes/terrain_0012.npz")
mesh["positions"]   # float32 [V, 3], metres about mesh["origin"]
mesh["triangles"]   # int32 [T, 3]"""
WORDS = [
    ("bound", "The largest distance in the picture between a visible point of the height field and the mesh."),
    ("update", "The work from the camera to the finished mesh, before Blender receives it."),
    ("level", "The number of times a triangle was halved; one more level has half the area."),
]


def write_page(
    path: Path,
    *,
    machine: str,
    size: int,
    resolution: tuple[int, int],
    error_px: float,
    summaries: list[dict],
    pictures: list[tuple[int, str]],
    crops: Sequence[Crop],
    effects: dict[int, dict],
    levels: dict,
    steps: dict[str, float],
) -> None:
    """Write the page of the demo, with its figures, pictures and tables, as an HTML file.

    Args:
        machine: phrase about the machine.
        size: samples along a side of the island.
        resolution: pixels of the pictures.
        error_px: criterion of the exported frames.
        summaries: one of each exported frame.
        pictures: frame and file name of each picture, the first for the top of the page.
        levels: of the two pictures with triangles in the colours of their levels: "frame", "error_px", "triangles".
        crops: enlarged parts of the frame of `levels`.
        effects: an EffectStatus by name for each pictured frame.
        steps: seconds by step.
    """
    frames = [{"frame": summary["frame"], **summary["terrains"][0]} for summary in summaries]
    by_frame = {frame["frame"]: frame for frame in frames}
    (first, first_name), *others = pictures
    blocks = [
        Lead(
            f"A camera flies over {size * size / 1e6:.1f} million samples. In each of its {len(frames)} frames the "
            f"mesh differs from them by at most {error_px:g} pixel, with few triangles."
        ),
        PagePicture(first_name, _frame_text(by_frame[first], resolution)),
        Figures(_figures(frames, size, error_px)),
        Heading("Four error bounds in comparison"),
        PictureStrip([_crop_picture(crop, size) for crop in crops]),
        Text(
            f"The part of frame {levels['frame']} in which these errors differ most, pixel by pixel. Its lower left "
            "half shows the edges of the triangles."
        ),
        *(PagePicture(name, _frame_text(by_frame[frame], resolution)) for frame, name in others),
        *_level_blocks(levels),
        *_material_blocks(effects),
        Heading("Frame by frame"),
        Plot(
            "frames.svg",
            "Bars: triangles. Line: milliseconds of the update. Each frame depends on its camera alone, so frames are "
            "the same in any order and on any machine.",
            _chart(frames),
        ),
        _frames_table(frames),
        Heading("The files"),
        Text(
            "island.blend is the scene: open it with the extension installed and play it. meshes/ holds the arrays of "
            "every frame, readable without Blender:"
        ),
        Code(READ),
        Heading("What the words mean"),
        Words(WORDS),
        Text(
            f"Made in {sum(steps.values()):.0f} s on {machine}: "
            + ", ".join(f"{step.lower()} {seconds:.1f} s" for step, seconds in steps.items())
            + "."
        ),
    ]
    write_text(path, as_html(TITLE, blocks))


def _level_blocks(levels: dict) -> list:
    """Return the section on the sizes of triangles, with the two drawings by level.

    levels: "frame", "error_px" and "triangles" of the drawings.
    """
    drawn = f"Frame {levels['frame']} at {levels['error_px']:g} pixels, {levels['triangles']:,} triangles"
    from_camera = PagePicture("levels.png", f"{drawn}, from the camera.")
    from_above = PagePicture("plan.png", "The same mesh from above; the red lines bound the camera's view.")
    return [
        Heading("Where the triangles are"),
        Text(
            "Each triangle has the colour of its level, from pale (coarse) through blue to red (fine). Fine triangles "
            "are near the camera, in view and on rough ground. Ground outside the picture stays coarse, and levels "
            "meet without cracks."
        ),
        PictureStrip([from_camera, from_above], first_wide=True),
    ]


def _material_blocks(effects: dict[int, dict]) -> list:
    """Return the section on the maps and attributes of the material, with the table of computed attributes.

    effects: the EffectStatus of each attribute by its name, by the number of the pictured frame.
    """
    return [
        Heading("What the material reads"),
        Text(
            "The colours are layers by rules of height, slope, scree and snow; rivers and lakes are a separate mesh. "
            "Colours, normals and sky visibility are baked maps with the resolution of the flight, so shading does "
            "not depend on the triangles. The material reads the depth of snow at the vertices. It does not read the "
            f"other attributes there, so they are not computed: {', '.join(_skipped(effects))}."
        ),
        _effects_table(effects),
    ]


def _figures(frames: list[dict], size: int, error_px: float) -> list[tuple[str, str]]:
    """Return (value, meaning) of the main figures of all frames.

    frames: values of each exported frame by name. size: samples along a side. error_px: the criterion.
    """
    triangles = [frame["triangles"] for frame in frames]
    worst = bound_text(max(frame["bound_px"] for frame in frames), "px")
    return [
        (f"{statistics.median(triangles):,.0f}", "triangles a frame, the median"),
        (f"{statistics.median(frame['ms']['total'] for frame in frames):.0f} ms", "an update, the median"),
        (worst, f"the largest bound, for a criterion of {error_px:g} px"),
        (f"{size * size / 1e6:.1f} M", f"samples, {size:,} x {size:,}"),
        (f"{_share_of_grid(statistics.median(triangles), size)}", "of the triangles of the whole grid"),
    ]


def _share_of_grid(triangles: float, size: int) -> str:
    """Return triangles as per cent of those of the whole grid of `size` x `size` samples."""
    return f"{100 * triangles / (2 * (size - 1) ** 2):.2g} %"


def _crop_picture(crop: Crop, size: int) -> PagePicture:
    """Return the picture of one error in the comparison, with its triangles as the caption; it is embedded only."""
    cost = f"{crop.triangles:,} triangles, {_share_of_grid(crop.triangles, size)} of the grid's"
    return PagePicture("", cost, f"{crop.error_px:g} px", png(crop.pixels))


def _frame_text(frame: dict, resolution: tuple[int, int]) -> str:
    """Describe a frame: its triangles, bound and time of the update."""
    return (
        f"Frame {frame['frame']}: {frame['triangles']:,} triangles, error at most "
        f"{bound_text(frame['bound_px'], 'px')} in a picture of {resolution[0]} x {resolution[1]}, updated in "
        f"{frame['ms']['total']:.0f} ms."
    )


def _skipped(effects: dict[int, dict]) -> list[str]:
    """Return the names of the effects that no pictured frame has computed."""
    return [name for name in next(iter(effects.values())) if all(frame[name].skipped for frame in effects.values())]


def _effects_table(effects: dict[int, dict]) -> Table:
    """Return the table of computed attributes: their readers in the first pictured frame, and their cost in each.

    effects: the EffectStatus of each attribute by its name, by the number of the pictured frame.
    """
    skipped, rows = _skipped(effects), []
    for name, first in next(iter(effects.values())).items():
        if name not in skipped:
            cost = [f"{plain(frame[name].ms)} ms, {frame[name].computed:,}" for frame in effects.values()]
            rows.append([name, " and ".join(first.readers), *cost])
    return Table(["Effect", "Read by", *(f"Frame {number}: time, vertices" for number in effects)], rows)


def _frames_table(frames: list[dict]) -> Table:
    """Return the table with a row for each frame."""
    rows = [
        [
            str(frame["frame"]),
            *(f"{frame[name]:,}" for name in ("triangles", "vertices")),
            bound_text(frame["bound_px"], "px"),
            f"{frame['ms']['total']:.1f}",
        ]
        for frame in frames
    ]
    return Table(["Frame", "Triangles", "Vertices", "Bound", "Update, ms"], rows)


def _chart(frames: list[dict]) -> str:
    """Draw triangles as bars and milliseconds as a line, each from 0 to its maximum; return the drawing as SVG.

    frames: values of each exported frame by name.
    """
    width, height, left, right, top, bottom = 1040, 240, 72, 72, 16, 28
    wide, high = width - left - right, height - top - bottom
    max_triangles, max_ms = max(f["triangles"] for f in frames), max(f["ms"]["total"] for f in frames)
    pitch = wide / len(frames)  # of the bars, which are 72 % as wide
    parts, line = [], []
    for i, frame in enumerate(frames):
        x, tall = left + i * pitch, high * frame["triangles"] / max_triangles
        parts.append(box(x + pitch * 0.14, top + high - tall, pitch * 0.72, tall, TEAL, 'opacity="0.75"'))
        parts.append(text(x + pitch / 2, height - 8, str(frame["frame"]), "middle", "soft small"))
        line.append((x + pitch / 2, top + high * (1 - frame["ms"]["total"] / max_ms)))
    parts.append(path(line, RED, 2))
    for fraction in (1, 0.5):  # labels of the two axes
        y = top + 4 + high * (1 - fraction)
        parts.append(text(left - 8, y, f"{fraction * max_triangles:,.0f}", "end", "soft small"))
        parts.append(text(width - right + 8, y, f"{fraction * max_ms:.0f} ms", look="small", colour=RED))
    return picture(width, height, "Triangles and milliseconds for each frame", parts)
