# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs in `examples/` run one after the other in one folder, and print what their comments promise."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import unregister_attribute

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("example")


def numbers(text: str, pattern: str) -> list[float]:
    return [float(found.replace(",", "")) for found in re.findall(pattern, text)]


def check_01_first_mesh(output, folder):
    triangles, bounds = numbers(output, r": ([\d,]+) triangles"), numbers(output, r"bound ([\d.]+) px")
    assert len(triangles) == len(bounds) == 4 and triangles == sorted(triangles)
    assert all(bound <= asked for bound, asked in zip(bounds, (8, 4, 2, 1), strict=True))
    assert "attribute terrain_level: int32" in output


def check_02_flight(output, folder):
    frames = numbers(output, r"frame \d: ([\d,]+) triangles")
    assert len(frames) == 8 and len(set(frames)) > 1 and "the same mesh alone: True" in output
    assert "the same meshes by four threads: True" in output
    assert all(wide < 100 for wide in numbers(output, r"is in triangle \d+, ([\d.]+) m wide"))


def check_03_bake_and_fit(output, folder):
    baked, fitted = numbers(output, r"([\d,]+) triangles")
    assert fitted < 0.8 * baked and max(numbers(output, r"at most ([\d.]+) m")) <= 2.0
    assert (folder / "baked.npz").stat().st_size > (folder / "fitted.npz").stat().st_size


def check_04_measure(output, folder):
    rows = re.findall(r"asked ([\d.]+) (\w+): bound ([\d.]+) \w+, measured ([\d.]+)", output)
    assert [unit for _, unit, *_ in rows] == ["px", "px", "m", "m"]
    assert all(0 < float(measured) <= float(bound) <= float(asked) for asked, _, bound, measured in rows)
    assert 100 <= numbers(output, r"too high: measured ([\d.]+) m")[0] <= 101


def check_05_inside_blender(output, folder):
    asked, kept, free = numbers(output, r"(?:camera|away|free): ([\d,]+) triangles\n")
    assert asked == kept > free > 0 and (folder / "island.blend").exists()


def check_06_an_effect(output, folder):
    assert numbers(output, r"noon_sun of ([\d,]+)")[0] > 1000 and "computed: detail_normal, noon_sun;" in output
    least, most = numbers(output, r"([\d]\.[\d]+)")
    assert 0.0 <= least < 0.5 < most <= 1.0


def check_07_queries(output, folder):
    assert 0 < numbers(output, r"slope of (\d+) degrees")[0] < 60
    assert numbers(output, r"sees ([\d,]+) samples")[0] > 100
    assert numbers(output, r"meets the ground ([\d.]+) m from it")[0] < 1e-3
    low, high = (numbers(output, rf"has {pattern}")[0] for pattern in (r"([\d.-]+) to", r"[\d.-]+ to ([\d.]+) m"))
    assert low < high and numbers(output, r"climbs ([\d,]+) m")[0] > 100
    assert numbers(output, r"are ([\d.]+) m off the surface")[0] < 1e-3


def check_08_scatter(output, folder):
    assert all(count > 1000 for count in numbers(output, r"frame \d: ([\d,]+) points"))
    assert numbers(output, r"moved ([\d.]+) m") == [0.0, 0.0] and max(numbers(output, r"came, ([\d.]+)%")) < 5
    with np.load(folder / "points.npz") as file:
        assert file["rotation"].shape == (len(file["id"]), 4)


CHECKS = {name.removeprefix("check_"): check for name, check in globals().items() if name.startswith("check_")}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_shows_what_it_says(path, folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(path), str(folder)])
    runpy.run_path(str(path), run_name="__main__")
    unregister_attribute("noon_sun")  # of example 06: other tests list all attributes
    CHECKS[path.stem](capsys.readouterr().out, folder)


def test_examples_are_short_and_numbered():
    assert [path.stem for path in EXAMPLES] == sorted(CHECKS)
    for number, path in enumerate(EXAMPLES, 1):
        assert path.stem.startswith(f"{number:02d}_") and len(path.read_text(encoding="utf-8").splitlines()) <= 60
