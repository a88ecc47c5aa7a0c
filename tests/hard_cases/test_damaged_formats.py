# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 85: damaged files of every format that GDAL reads, in the import's sandbox."""

import os

import numpy as np
import pytest
import rasterio
from height_files import WRITERS, heights
from hostile_files import damaged
from sandboxed_reads import read_in_sandbox

# Options that imports set for the rest of their process.
OF_IMPORTS = {"GDAL_PAM_ENABLED": "NO", "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR"}
MANY = max(6, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 100)


def test_case_85_files_are_written_after_an_import(tmp_path):
    """The test below failed after one of a mosaic, because GDAL found no header beside a .flt file."""
    with rasterio.Env(**OF_IMPORTS):
        for name, (write, place, _) in WRITERS.items():
            assert write(tmp_path / name, heights(), *place).stat().st_size > 0


@pytest.mark.parametrize("files", [2, pytest.param(MANY, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("names", [list(WRITERS)[::2], list(WRITERS)[1::2]], ids=["even", "odd"])
def test_case_85_a_damaged_file_is_a_raster_or_one_error(tmp_path, names, files):
    """Truncated and changed files are read or refused in one sentence: no crash, no traceback, no endless loop."""
    random, paths = np.random.default_rng(85), []
    for name in names:
        write, place, _ = WRITERS[name]
        (tmp_path / "good").mkdir(exist_ok=True)
        content = write(tmp_path / "good" / name, heights(), *place).read_bytes()
        for number in range(files):
            paths.append(tmp_path / f"{number}{name}")
            cut = content[: random.integers(1, len(content))]
            paths[-1].write_bytes(cut if number % 3 == 0 else damaged(content, random))
            for beside in (tmp_path / "good").glob(f"{name.partition('.')[0]}.[hsp][gdr][rdj]*"):
                (tmp_path / f"{number}{beside.name}").write_bytes(beside.read_bytes())
    found = read_in_sandbox(paths)
    outcomes = dict(zip((file.name for file in paths), found, strict=True))
    assert {name: end for name, end in outcomes.items() if end[0] not in ("read", "error")} == {}
    errors = [text for outcome, text in found if outcome == "error"]
    assert len(errors) > len(paths) / 4
    assert [text for text in errors if "\n" in text or not text.endswith(".") or len(text) > 900] == []
