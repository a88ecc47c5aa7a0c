# SPDX-License-Identifier: GPL-3.0-or-later
"""Write docs/animation.md: how far points pop, whether a scatter keeps its points, and the figures of a farm's job.

`make animation` runs it in the environment of the tests; every figure on the page is of that run, but for those of the
farm, which `make fly-over` writes (it takes the real Blender program).
"""

import sys
import tempfile
from pathlib import Path

from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.export.exporting import write_text
from adaptive_terrain.operators.text.machine import describe_machine
from adaptive_terrain.operators.text.page_blocks import Heading, Plot, Text, as_markdown
from animation_hidden import hidden_section
from animation_popping import popping_section
from animation_scatter import scatter_section
from fly_over import farm_section

DOCS = Path(__file__).resolve().parents[1] / "docs"
INTRODUCTION = (
    "Written by `make animation`; do not edit it by hand. A film needs three things that meshes of changing detail do "
    "not give by themselves: ground that does not pop, things on it that stand still, and a farm that renders any "
    "frame alone. This page shows how each is achieved, with measurements."
)


def main() -> int:
    """Run the command line."""
    try:
        with tempfile.TemporaryDirectory(prefix="adaptive-terrain-animation-") as folder:
            blocks = [Text(INTRODUCTION), *popping_section(Path(folder)), *hidden_section()]
            blocks += scatter_section(Path(folder))
    except TerrainError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    blocks += farm_section(DOCS / "fly_over.json")
    blocks += [
        Heading("The machine"),
        Text(", ".join(f"{name}: {value}" for name, value in describe_machine().items()) + "."),
    ]
    for block in blocks:
        if isinstance(block, Plot):
            write_text(DOCS / block.name, block.svg)
    write_text(DOCS / "animation.md", as_markdown("Animation", blocks))
    return 0


if __name__ == "__main__":
    sys.exit(main())
