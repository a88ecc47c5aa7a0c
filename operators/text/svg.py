# SPDX-License-Identifier: GPL-3.0-or-later
"""Self-contained SVG drawings for light and dark pages, and the palette that pages share."""

import html
from collections.abc import Iterable

Point = tuple[float, float]

PALETTE = """:root { --ink: #1c1f26; --soft: #5d6470; --line: #d3cfc5; --paper: #faf9f5; --wash: #ece9e0;
  --teal: #2f6f73; --red: #b4431e; --blue: #4a5fa8; --gold: #b27c12; --green: #6d8a1c; --purple: #8a4f9e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e9e6df; --soft: #a9afb9; --line: #434852; --paper: #16181c;
  --wash: #24272d; --teal: #5fb3a8; --red: #ef8a5c; --blue: #93a6ee; --gold: #e2b45c; --green: #b0cc62;
  --purple: #cf9ae2; } }"""
INK, SOFT, LINE, PAPER, WASH, TEAL, RED, BLUE, GOLD, GREEN, PURPLE = (
    f"var(--{name})"
    for name in ("ink", "soft", "line", "paper", "wash", "teal", "red", "blue", "gold", "green", "purple")
)
STYLE = """
svg text { font: 13px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: var(--ink); }
svg .soft { fill: var(--soft); } svg .small { font-size: 12px; } svg .bold { font-weight: 600; }"""


def picture(width: float, height: float, label: str, parts: Iterable[str]) -> str:
    """Return a drawing, width x height pixels, on an opaque card. `label`: its description. `parts`: SVG elements."""
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img" '
            f'aria-label="{html.escape(label)}">',
            f"<style>{PALETTE}{STYLE}</style>",
            f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{PAPER}"/>',
            *parts,
            "</svg>\n",
        ]
    )


def text(x: float, y: float, words: str, anchor: str = "start", look: str = "", colour: str = "") -> str:
    """Draw a text. `anchor`: start, middle or end. `look`: any of soft, small and bold."""
    more = (f' class="{look}"' if look else "") + (f' style="fill:{colour}"' if colour else "")
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{html.escape(words)}</text>'


def path(points: Iterable[Point], stroke: str, width: float = 1.5, fill: str = "none", more: str = "") -> str:
    """Draw a line through the points, closed if it is filled."""
    kind, places = "polyline" if fill == "none" else "polygon", " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    look = f'fill="{fill}" stroke="{stroke}" stroke-width="{width:g}" stroke-linejoin="round"'
    return f'<{kind} points="{places}" {look}{" " + more if more else ""}/>'


def box(x: float, y: float, width: float, height: float, fill: str, more: str = "") -> str:
    """Return an SVG rectangle. `more`: further attributes."""
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}"'
        f"{' ' + more if more else ''}/>"
    )


def dot(at: Point, fill: str, radius: float = 4.5) -> str:
    """Return an SVG circle."""
    return f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{fill}"/>'
