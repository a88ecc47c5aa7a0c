# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's page: one HTML file beside its pictures, with the figures of the run that made it."""

import html
import statistics
from pathlib import Path

from ..output.exporting import write_text
from ..text.page_blocks import document
from ..text.shown_bounds import bound_text


def write_page(
    path: Path,
    *,
    machine: str,
    size: int,
    resolution: tuple[int, int],
    error_px: float,
    summaries: list[dict],
    pictures: list[tuple[int, str]],
    levels: dict,
    steps: dict[str, float],
) -> None:
    """Write the page: `summaries` of the exported frames, `steps` in seconds, `levels` the figures of the drawings."""
    frames = [{"frame": summary["frame"], **summary["terrains"][0]} for summary in summaries]
    by_frame = {frame["frame"]: frame for frame in frames}
    updates = [frame["ms"]["total"] for frame in frames]
    triangles = [frame["triangles"] for frame in frames]
    worst = bound_text(max(frame["bound_px"] for frame in frames), "px")
    figures = [
        (f"{size * size / 1e6:.1f} million", f"samples in the height field, {size} x {size}"),
        (f"{min(triangles):,} – {max(triangles):,}", "triangles a frame"),
        (worst, f"largest error bound; {error_px:g} px was asked for"),
        (f"{statistics.median(updates):.0f} ms", "median update, camera to finished mesh"),
    ]
    body = [
        "<h1>An island, seen from the air</h1>",
        f'<p class="lead">A camera flies over a height field of {size * size / 1e6:.1f} million samples. For each of '
        f"its {len(frames)} frames the terrain was refined to what that camera can see: nowhere on screen is the mesh "
        f"more than {error_px:g} pixel from the height field, and where fewer triangles hold that, fewer are made.</p>",
        '<div class="figures">'
        + "".join(f"<div><b>{value}</b><span>{html.escape(what)}</span></div>" for value, what in figures)
        + "</div>",
    ]
    for frame, name in pictures:
        body.append(_figure(name, f"Frame {frame}", _frame_text(by_frame[frame], resolution)))
    drawn = f"Frame {levels['frame']} at {levels['error_px']:g} pixels, {levels['triangles']:,} triangles"
    body += [
        "<h2>Where the triangles are</h2>",
        "<p>Each triangle in the colour of its level, from pale (coarse) through blue to red (fine). They gather on "
        "what is near, in view and rough; what lies outside the picture stays coarse, and no crack opens where levels "
        "meet.</p>",
        '<div class="pair">'
        + _figure("levels.png", "Levels from the camera", f"{drawn}, from the camera.")
        + _figure("plan.png", "Levels from above", "The same mesh from above; the red lines bound the camera's view.")
        + "</div>",
        "<h2>Frame by frame</h2>",
        _chart(frames),
        '<p class="small">Bars: triangles. Line: milliseconds of the update. Each frame depends on its camera alone, '
        "so frames rendered in any order, on any machine, are the same.</p>",
        _table(frames),
        "<h2>The files</h2>",
        "<p><code>island.blend</code> is the scene: open it with the extension installed, and play. "
        "<code>meshes/</code> has every frame as arrays, readable without Blender:</p>",
        "<pre>import numpy as np\n"
        'mesh = np.load("meshes/terrain_0012.npz")\n'
        'mesh["positions"]   # float32 [V, 3], metres about mesh["origin"]\n'
        'mesh["triangles"]   # int32 [T, 3]</pre>',
        f'<p class="small">Made in {sum(steps.values()):.0f} s on {html.escape(machine)}: '
        + ", ".join(f"{html.escape(step.lower())} {seconds:.1f} s" for step, seconds in steps.items())
        + ".</p>",
    ]
    write_text(path, document("Adaptive Terrain: a demonstration", body))


def _figure(name: str, title: str, caption: str) -> str:
    return (
        f'<figure><img src="{name}" alt="{html.escape(title)}"><figcaption>{html.escape(caption)}</figcaption></figure>'
    )


def _frame_text(frame: dict, resolution: tuple[int, int]) -> str:
    return (
        f"Frame {frame['frame']}: {frame['triangles']:,} triangles, error at most "
        f"{bound_text(frame['bound_px'], 'px')} in a picture of {resolution[0]} x {resolution[1]}, updated in "
        f"{frame['ms']['total']:.0f} ms."
    )


def _table(frames: list[dict]) -> str:
    names = ("Frame", "Triangles", "Vertices", "Screen bound", "Update, ms")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    rows = [
        f"<tr><td>{f['frame']}</td><td>{f['triangles']:,}</td><td>{f['vertices']:,}</td>"
        f"<td>{bound_text(f['bound_px'], 'px')}</td><td>{f['ms']['total']:.1f}</td></tr>"
        for f in frames
    ]
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _chart(frames: list[dict]) -> str:
    """Triangles as bars and milliseconds as a line, each from 0 to its own maximum, as one SVG."""
    width, height, left, right, top, bottom = 1040, 240, 64, 72, 16, 28
    plot_w, plot_h = width - left - right, height - top - bottom
    most, slowest = max(f["triangles"] for f in frames), max(f["ms"]["total"] for f in frames)
    pitch = plot_w / len(frames)
    parts, line = [], []
    for i, frame in enumerate(frames):
        x, h = left + i * pitch, plot_h * frame["triangles"] / most
        parts.append(
            f'<rect x="{x + pitch * 0.14:.1f}" y="{top + plot_h - h:.1f}" width="{pitch * 0.72:.1f}" height="{h:.1f}" '
            'fill="var(--bar)" opacity="0.75"/>'
            f'<text x="{x + pitch / 2:.1f}" y="{height - 8}" text-anchor="middle">{frame["frame"]}</text>'
        )
        line.append(f"{x + pitch / 2:.1f},{top + plot_h * (1 - frame['ms']['total'] / slowest):.1f}")
    parts.append(f'<polyline points="{" ".join(line)}" fill="none" stroke="var(--mark)" stroke-width="2"/>')
    parts.append(
        f'<line x1="{left}" x2="{width - right}" y1="{top + plot_h}" y2="{top + plot_h}" stroke="var(--line)"/>'
    )
    for y, many, slow in ((top + 4, most, slowest), (top + plot_h / 2 + 4, most / 2, slowest / 2)):
        parts.append(f'<text x="{left - 8}" y="{y:.1f}" text-anchor="end">{many:,.0f}</text>')
        parts.append(f'<text x="{width - right + 8}" y="{y:.1f}" fill="var(--mark)">{slow:.0f} ms</text>')
    label = "Triangles and milliseconds for each frame"
    return f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
