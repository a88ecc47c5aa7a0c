# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw every figure of docs/method into docs/images: `make figures`."""

from pathlib import Path

from figures_of_data import band, error, frame, passes
from figures_of_meshes import border, curve, diamond, strip

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
FIGURES = {draw.__name__: draw for draw in (frame, diamond, curve, strip, band, error, border, passes)}


def main() -> None:
    """Write each figure as `method_NAME.svg`."""
    for name, draw in FIGURES.items():
        (IMAGES / f"method_{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
