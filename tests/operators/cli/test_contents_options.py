# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of `import` and `info` about the contents of files, for one file and for several as one terrain."""

import pytest
from adaptive_terrain.cbt_terrain.importing import import_process
from adaptive_terrain.cbt_terrain.mosaic import mosaic_info
from store_exports import run

OPTIONS = ("--no-data", "-1", "--holes", "--band", "2", "--encoding", "mapbox", "--cell", "2.5")


@pytest.fixture
def seen(tmp_path, monkeypatch):
    """Return a list that gets the settings of imports and descriptions, in place of both; make a folder of tiles."""
    (tmp_path / "tiles").mkdir()
    for name in ("a.laz", "b.tif"):
        (tmp_path / "tiles" / name).write_bytes(b"a")
    settings = []
    monkeypatch.setattr(import_process, "import_source", lambda given, *_: settings.append(given) or {})
    for name in ("describe_sources", "describe_source"):
        monkeypatch.setattr(mosaic_info, name, lambda given: settings.append(given) or {})
    return settings


@pytest.mark.parametrize("source", ["tiles", "tiles.zip", "a.laz"])
def test_points_of_several_files_may_have_a_cell_size(tmp_path, seen, source):
    assert run("import", tmp_path / source, "--store", tmp_path / "store", "--cell", "2.5") == 0
    assert [given.cell for given in seen] == [2.5]


def test_info_reads_files_as_an_import_does(tmp_path, seen):
    assert run("import", tmp_path / "tiles", "--store", tmp_path / "store", *OPTIONS) == 0
    assert run("info", tmp_path / "tiles", *OPTIONS) == 0
    assert seen[0] == seen[1] and (seen[1].no_data, seen[1].holes, seen[1].band) == (-1.0, True, 2)
    assert (seen[1].encoding, seen[1].cell) == ("mapbox", 2.5)


def test_options_of_other_formats_are_refused_by_both(tmp_path, seen, capsys):
    for verb in ("import", "--store", tmp_path / "store"), ("info",):
        assert run(*verb, tmp_path / "a.hgt", "--cell", "2.5") == 2
        assert "(--cell) has no effect on" in capsys.readouterr().err
    assert not seen
