# SPDX-License-Identifier: GPL-3.0-or-later
"""Hook of mkdocs that adds the page of the hard cases to the site: each case, its tests, and what they assert.

A test belongs to a case by its name, `test_case_NN_...`; the first line of its docstring states the assertion.
"""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests" / "hard_cases"
TEST_NAME = re.compile(r"test_case_(\d\d)_\w+")
PAGE = "hard_cases.md"

CASES = {
    1: "Depth 48 in float32",
    2: "Ids at 2^31, 2^53 and the deepest level",
    3: "2^28 and more possible leaves",
    4: "6.4e6 m from the origin",
    5: "Heights of 8 km in 16 bits",
    6: "Denormal heights; vertical scale 1e9 and 1e-9",
    7: "More than 2^24 corners",
    8: "NaN, infinities and no-data",
    9: "All samples no-data",
    10: "A constant map",
    11: "1 x 1, 1 x N, 2 x 2 rasters",
    12: "Not a power of two, not square, 1 : 1000",
    13: "A cliff of gradient 1e6",
    14: "All heights negative",
    15: "A spike of a single sample",
    16: "A checkerboard at the sampling limit",
    17: "-0.0 and +0.0",
    18: "int16 -32768",
    19: "Pixel-is-point and pixel-is-area",
    20: "Truncated, corrupted or lying files; files that vanish; a full disk",
    21: "Eye on a vertex, on the surface, inside, below",
    22: "Straight down, straight up, upside down",
    23: "Orthographic, also of scale 0",
    24: "Field of view of 180 and 0.0000 degrees",
    25: "Panoramic and custom cameras",
    26: "A triangle through the near plane",
    27: "clip_start beyond clip_end",
    28: "NaN in the camera's matrix",
    29: "Location 1e30; shift 1e6; pixels 1 : 100; border; 1 %",
    30: "Looking away",
    31: "Several cameras, stereo",
    32: "No camera in the scene",
    33: "Mirrored, sheared, non-uniform scale",
    34: "Zero scale",
    35: "Animated parents, subframes, frames in random order",
    36: "Motion blur",
    37: "Budget 0, 1, 2, exactly full",
    38: "A larger budget",
    39: "A second update at the same view",
    40: "One thread, two, sixteen",
    41: "A -> B -> A",
    42: "The camera trembles by 1e-6",
    43: "A teleport",
    44: "Split, then merge",
    45: "A diamond merges whole or not at all",
    46: "Random views",
    47: "Undo, redo, save, reload, duplicate, delete, link",
    48: "1,000 frames",
    49: "Kill -9 in the middle of an export",
    50: "A lake at rest on a rough bed",
    51: "Dry and wet fronts",
    52: "A time step at its limit, and above",
    53: "Rain on one cell",
    54: "A pit with no outlet; a perfect plateau",
    55: "Mass: water, snow, rock and sediment",
    56: "Twice the resolution",
    57: "Tile by tile",
    58: "The same seed, the same bytes",
    59: "Light: rays along axes, through corners, grazing, from outside, upright; the sun below the horizon",
    60: "Points that rise to their places: both ends of the ramp, neighbours at different stages",
    61: "Viewport and render detail differ, frames other than 0, every format in every order",
    62: "A raster that does not fit the lattice",
    63: "Height maps that are attacks",
    64: "A store with anything in it",
    65: "Interrupts at random times",
    67: "A terrain 32 km wide in a fresh scene",
    68: "A background render whose mesh is stale",
    69: "A source 7 samples wide and 1,024 long",
    71: "What nearer ground hides",
    72: "What a scene reads: mutes, groups used twice, constant factors, drivers, computed names",
    73: "Scatter over a flight: no point moves, none appears full-grown",
    75: "Files that share border rows, columns and corners",
    76: "Files of one sample, one row, one column",
    77: "Files without any height",
    78: "Thousands of tiny files",
    79: "Links in a folder of files",
    80: "A file that changes during the import",
    81: "Files at the date line",
    82: "Polar files, and the pole",
    83: "Different units, scales and types",
    84: "Duplicated files",
    85: "Damaged height maps of every format, in the sandbox",
    86: "Files with different bands",
    87: "Two small files 3,000 km apart",
    88: "A bad file in a folder",
    89: "Names with odd characters",
    90: "Tile indexes that lead elsewhere",
}

HEAD = """\
# Hard cases

Written from the tests in `tests/hard_cases`; `make hard-cases` runs them. A test that makes a mesh also asserts, by one
function (`tests/support/invariants.py`):

* **I1** coordinates, normals and texture coordinates are finite, normals have length 1 within 1e-6
* **I2** every interior edge belongs to exactly two triangles, every border edge to one, on the terrain's border
* **I3** V - E + F = 1, and every triangle is counter-clockwise seen from above
* **I4** the leaves partition the domain: the sum of 2^-depth is the number of roots, in integers
* **I5** no two vertices are at one place
* **I6** every triangle has a positive area in the plane, and the areas add up

| # | Case | What is asserted | Test |
| --: | --- | --- | --- |
"""


def find_tests(folder: Path = TESTS) -> list[tuple[int, str, str, str]]:
    """Return the tests of a folder by case: number, file, function, and the statement that it asserts.

    Raises:
        ValueError: A test has no number or no docstring.
    """
    found = []
    for path in sorted(folder.glob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test"):
                continue
            number, asserts = TEST_NAME.fullmatch(node.name), ast.get_docstring(node)
            if not number or int(number[1]) not in CASES:
                raise ValueError(f"{path.name}: {node.name} has no case number; call it test_case_NN_...")
            if not asserts:
                raise ValueError(f"{path.name}: {node.name} does not say what it asserts; give it a docstring")
            found.append((int(number[1]), path.name, node.name, asserts.splitlines()[0]))
    return sorted(found, key=lambda test: test[0])


def page(tests: list[tuple[int, str, str, str]]) -> str:
    """Return the page, with a row for each test; only the first row of a case names it."""
    rows, last = [], None
    for case, file, function, asserts in tests:
        name = CASES[case] if case != last else ""
        rows.append(f"| {case} | {name} | {asserts.replace('|', '&#124;')} | `{file}::{function}` |\n")
        last = case
    return HEAD + "".join(rows)


def on_files(files, config):
    """Add the page to the files of the site."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, PAGE, content=page(find_tests())))
    return files
