# SPDX-License-Identifier: GPL-3.0-or-later
"""Jumps of points with and without geomorph and the cost of geomorph: a part of the page of `accuracy`."""

from dataclasses import replace

from ...cbt_terrain.accuracy.rows import Row
from ..text.log_plot import Curve, draw
from ..text.page_blocks import Heading, Plot, Table, Text
from ..text.svg import BLUE, RED

HEAD = [
    "requested",
    "pops: max, without",
    "smooth",
    "p99.9, without",
    "smooth",
    "shading: max, without",
    "smooth",
    "error: max, without",
    "smooth",
    "triangles ×",
    "ms ×",
]


def transitions_section(rows: list[Row], of: str, plot: str) -> list:
    """Return blocks of the page that compare popping with and without geomorph; [] without `paired_rows`.

    of: " of NAME" for headings if the page has several terrains, else "". plot: name of the plot's file. Each pair is a
    row without geomorph (`rough`) and one with it (`smooth`), of the same requested error.
    """
    pairs = paired_rows(rows)
    if not pairs:
        return []
    lines = [
        [
            f"{rough.setting.error:g} px",
            *(f"{row.popping_px.max:.3g}" for row in (rough, smooth)),
            *(f"{row.popping_px.p999:.3g}" for row in (rough, smooth)),
            *(f"{row.shading_change.max:.3g}" for row in (rough, smooth)),
            *(f"{row.error:.3g}" for row in (rough, smooth)),
            f"{smooth.triangles / rough.triangles:.2f}",
            f"{smooth.whole_ms / rough.whole_ms:.2f}",
        ]
        for rough, smooth in pairs
    ]
    return [
        Heading(f"What Geomorph{of} saves and costs"),
        Text(
            "Pixels by which points of the ground jump from one frame's mesh to the next one's, the largest and what "
            "99.9 % of them stay within; the largest change of a pixel's shading, in 255ths of white ground under the "
            "light that shows it most; the largest visible error; and the factors of triangles and of milliseconds to "
            "the finished mesh. A jump without it is as large as the error. With it, points move as far as the camera "
            "does: half the way a frame, half the jump."
        ),
        Table(HEAD, lines),
        Plot(plot, "Jumps of points against the tolerance, both logarithmic.", _draw_jumps(pairs)),
    ]


def paired_rows(rows: list[Row]) -> list[tuple[Row, Row]]:
    """Return pairs of rows of the same error, without geomorph and with it, where popping was measured.

    A setting whose `morph` is None was measured as the swept criterion has it. One with a number was measured the other
    way: 1 without geomorph, more with it. A pair has one row of each kind.
    """
    by_setting = {row.setting: row for row in rows if row.popping_px is not None}
    pairs = []
    for row in by_setting.values():
        other = by_setting.get(replace(row.setting, morph=None))
        if row.setting.morph is not None and other is not None:
            has_geomorph = row.setting.morph > 1
            pairs.append((other, row) if has_geomorph else (row, other))
    return pairs


def _draw_jumps(pairs: list[tuple[Row, Row]]) -> str:
    """Return the plot of the largest jump and of the 99.9th percentile, without and with geomorph, as SVG.

    pairs: rows of the same error, without geomorph and with it.
    """
    curves = []
    for i, (name, colour) in enumerate((("without", RED), ("smooth", BLUE))):
        for part, label, dash in (("max", "largest", ""), ("p999", "99.9 %", "7 4")):
            points = [(pair[i].setting.error, getattr(pair[i].popping_px, part)) for pair in pairs]
            curves.append(Curve(f"{name}, {label}", colour, points, dash))
    return draw(curves, "requested error, px", "jump, px")
