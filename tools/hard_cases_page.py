# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the hard cases and write docs/hard_cases.md: each case, what its tests assert, and the result of that run.

    python tools/hard_cases_page.py            run and write
    python tools/hard_cases_page.py --check    only say whether the page lists the tests that there are

A test belongs to a case by its name, `test_case_NN_...`; the first line of its docstring states the assertion.
"""

import ast
import datetime
import importlib.metadata
import platform
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests" / "hard_cases"
PAGE = ROOT / "docs" / "hard_cases.md"
TEST_NAME = re.compile(r"test_case_(\d\d)_\w+")
NO_RESULT = "not run"

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
}

HEAD = """\
# Hard cases

Written by `make hard-cases` from the tests in `tests/hard_cases` and a run of them; a test in the suite compares the
rows with the tests. A test that makes a mesh also asserts, by one function (`tests/invariants.py`):

* **I1** coordinates, normals and texture coordinates are finite, normals have length 1 within 1e-6
* **I2** every interior edge belongs to exactly two triangles, every border edge to one, on the terrain's border
* **I3** V - E + F = 1, and every triangle is counter-clockwise seen from above
* **I4** the leaves partition the domain: the sum of 2^-depth is the number of roots, in integers
* **I5** no two vertices are at one place
* **I6** every triangle has a positive area in the plane, and the areas add up

"""


@dataclass(frozen=True)
class Test:
    """A test of a case: its `file` and `function`, and the statement that it `asserts`."""

    case: int
    file: str
    function: str
    asserts: str


def find_tests() -> list[Test]:
    """Return the tests of tests/hard_cases by case.

    Raises:
        ValueError: A test has no number or no docstring.
    """
    found = []
    for path in sorted(TESTS.glob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test"):
                continue
            number, asserts = TEST_NAME.fullmatch(node.name), ast.get_docstring(node)
            if not number or int(number[1]) not in CASES:
                raise ValueError(f"{path.name}: {node.name} has no case number; call it test_case_NN_...")
            if not asserts:
                raise ValueError(f"{path.name}: {node.name} does not say what it asserts; give it a docstring")
            found.append(Test(int(number[1]), path.name, node.name, asserts.splitlines()[0]))
    return sorted(found, key=lambda test: test.case)


def run(tests: list[Test]) -> tuple[dict[Test, str], int]:
    """Result of each test in one run of pytest, and pytest's exit status."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", str(TESTS), f"--junitxml={report}", "-p", "no:cacheprovider"]
        status = subprocess.run(command, cwd=ROOT).returncode
        outcomes: dict[tuple[str, str], list[str]] = {}
        for case in ElementTree.parse(report).iter("testcase"):
            # of a module that is skipped as a whole, its name stands where that of a test would
            file = (case.get("classname") or case.get("name")).rpartition(".")[2] + ".py"
            function = case.get("name").partition("[")[0] if case.get("classname") else ""
            outcomes.setdefault((file, function), []).append(_outcome(case))
    reasons = {test: outcomes.get((test.file, test.function)) or outcomes.get((test.file, "")) for test in tests}
    return {test: _summary(words or [NO_RESULT]) for test, words in reasons.items()}, status


def _outcome(case: ElementTree.Element) -> str:
    for kind in ("failure", "error"):
        if case.find(kind) is not None:
            return "failed"
    skip = case.find("skipped")
    if skip is None:
        return "passed"
    message = skip.get("message", "")
    if message == "collection skipped":  # a whole module: the reason follows the file in the text
        message = (skip.text or "").rpartition("Skipped: ")[2].removesuffix(")")[:-1]
    return f"skipped: {message}"


def _summary(outcomes: list[str]) -> str:
    """`passed`, `passed (30)`, or what happened to how many, failures first."""
    counts = {outcome: outcomes.count(outcome) for outcome in sorted(set(outcomes))}
    if len(outcomes) == 1:
        return outcomes[0]
    return ", ".join(f"{outcome} ({count})" for outcome, count in counts.items())


def rows(tests: list[Test]) -> list[tuple[str, str, str, str]]:
    """Number, name, assertion and test: the first four columns of the page."""
    result, last = [], None
    for test in tests:
        first = test.case != last
        last = test.case
        name = CASES[test.case] if first else ""
        result.append((str(test.case), name, _cell(test.asserts), f"`{test.file}::{test.function}`"))
    return result


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


def page(tests: list[Test], results: dict[Test, str]) -> str:
    """Return the page."""
    lines = ["| # | Case | What is asserted | Test | Result |", "| --: | --- | --- | --- | --- |"]
    for test, row in zip(tests, rows(tests), strict=True):
        lines.append("| " + " | ".join([*row, _cell(results[test])]) + " |")
    return HEAD + _about(results) + "\n" + "\n".join(lines) + "\n"


def _about(results: dict[Test, str]) -> str:
    passed = sum(result.startswith("passed") for result in results.values())
    packages = []
    for name in ("numpy", "warp-lang", "bpy"):
        try:
            packages.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            packages.append(f"no {name}")
    where = f"{platform.system()}, Python {platform.python_version()}, {', '.join(packages)}"
    return f"Run of {datetime.date.today()} ({where}): {passed} of {len(results)} tests passed.\n"


def listed(text: str) -> list[tuple[str, str, str, str]]:
    """Return the first four columns of each row of a page."""
    cells = [line.strip("| ").split(" | ") for line in text.splitlines() if re.match(r"\| \d", line)]
    return [tuple(cell.strip() for cell in row[:4]) for row in cells]


def results_of(text: str) -> list[str]:
    """Return the last column of each row of a page."""
    return [line.strip("| ").split(" | ")[-1] for line in text.splitlines() if re.match(r"\| \d", line)]


def main() -> int:
    """Run the command line."""
    tests = find_tests()
    if "--check" in sys.argv[1:]:
        return int(listed(PAGE.read_text(encoding="utf-8")) != rows(tests))
    results, status = run(tests)
    PAGE.write_text(page(tests, results), encoding="utf-8")
    print(f"{PAGE.relative_to(ROOT)}: {len(tests)} tests of {len({test.case for test in tests})} cases")
    return status


if __name__ == "__main__":
    sys.exit(main())
