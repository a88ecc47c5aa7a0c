# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder to export into: it may be a link of the user; links in it keep what they lead to."""

import os
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.run import partial_files
from adaptive_terrain.operators.export.exporting import write_frames, write_text

pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")


def export_into(out: Path) -> None:
    """Write frame 1 into a folder, without Blender."""

    def write(frame: int) -> dict:
        write_text(out / "a.txt", "frame")
        return {"files": {"a.txt": 5}, "terrains": [], "elapsed_ms": 0.0}

    write_frames(write, {}, lambda _: [], [1], out, resume=False, on_frame=lambda *_: None)


@pytest.fixture
def precious(tmp_path):
    folder = tmp_path / "precious"
    folder.mkdir()
    (folder / "mine.json").write_text("mine")
    return folder


def test_the_folder_may_be_a_link(tmp_path, precious):
    (tmp_path / "out").symlink_to(precious)
    for _ in range(2):
        export_into(tmp_path / "out")
    assert sorted(os.listdir(precious)) == ["a.txt", "frame_0001.json", "mine.json"]
    assert (precious / "mine.json").read_text() == "mine"


def test_a_summary_takes_the_place_of_a_link(tmp_path, precious):
    summary = tmp_path / "out" / "frame_0001.json"
    summary.parent.mkdir()
    summary.symlink_to(precious / "mine.json")
    export_into(summary.parent)
    assert (precious / "mine.json").read_text() == "mine"
    assert not summary.is_symlink() and sorted(os.listdir(summary.parent)) == ["a.txt", "frame_0001.json"]


def test_links_under_the_names_of_results_keep_their_targets(tmp_path, precious):
    """A result takes the link's place; a private folder that is a link is no abandoned one."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.txt").symlink_to(precious / "mine.json")
    private = out / f".partial-{partial_files.new_token()}"
    private.symlink_to(precious)
    export_into(out)
    assert (out / "a.txt").read_text() == "frame" and not (out / "a.txt").is_symlink()
    assert os.listdir(precious) == ["mine.json"] and (precious / "mine.json").read_text() == "mine"
