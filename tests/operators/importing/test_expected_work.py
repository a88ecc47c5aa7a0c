# SPDX-License-Identifier: GPL-3.0-or-later
"""An import of several files warns at its beginning if it takes long or finds hardly any data."""

from dataclasses import replace
from unittest.mock import Mock

import pytest
from adaptive_terrain.cbt_terrain.importing import import_process
from adaptive_terrain.operators.importing import store_location
from adaptive_terrain.operators.importing.expected_work import warn_of_work
from adaptive_terrain.operators.importing.import_terrain import ImportTerrain
from modal_runs import running, to_the_end

USUAL = {"files": 2, "expected_seconds": 600.0, "expected_disk_mb": 6500.0, "gap_percent": 90.0}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, None),
        ({"expected_seconds": 3300.0}, "2 files is expected to take 55:00 min and 6.5 GB on the disk."),
        ({"gap_percent": 93.214}, "10:00 min and 6.5 GB on the disk, and 93.21 % of the rectangle has no data."),
    ],
)
def test_long_imports_and_wide_gaps_are_reported(values, words):
    operator = Mock()
    warn_of_work(operator, USUAL | values)
    calls = operator.report.call_args_list
    assert [call.args[0] for call in calls] == ([{"WARNING"}] if words else [])
    assert not words or (words in calls[0].args[1] and "press the cross" in calls[0].args[1])


def test_the_warning_comes_before_the_result(scene, add_terrain, tmp_path, monkeypatch):
    """The child process sends its report on the files before the long work."""

    class AnnouncedImport(import_process.ImportJob):
        def poll(self):
            progress = super().poll()
            return progress if progress.done else replace(progress, preview=USUAL | {"expected_seconds": 4000.0})

    monkeypatch.setattr(import_process, "ImportJob", AnnouncedImport)
    monkeypatch.setattr(store_location, "data_folder", lambda: tmp_path)  # there is no store of an earlier run
    terrain = add_terrain()
    terrain.adaptive_terrain.store, terrain.adaptive_terrain.island_size = "", 65
    operator = running(ImportTerrain, terrain)
    assert to_the_end(operator) == {"FINISHED"}
    texts = [call.args[1] for call in operator.report.call_args_list]
    warned = [number for number, text in enumerate(texts) if "expected to take 1:06 h" in text]
    imported = [number for number, text in enumerate(texts) if text.startswith("65 x 65 samples")]
    assert len(warned) == len(imported) == 1 and warned < imported
