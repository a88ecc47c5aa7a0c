# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line reads from words, and how it tells how far it is."""

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.cli import command_line
from adaptive_terrain.operators.cli.verbs import print_fields
from adaptive_terrain.operators.export.formats import parse_formats, parse_frames
from adaptive_terrain.operators.text.console import Progress, duration


def test_a_text_from_outside_cannot_command_the_terminal(capsys):
    print_fields({"crs": "\x1b]0;name\x07EPSG:1\n\ud800", "warnings": ["\x9b2J"], "middle": ["\x1b", 2]})
    assert capsys.readouterr().out == "crs: ?]0;name?EPSG:1 ?\nwarning: ?2J\nmiddle: ?, 2\n"


@pytest.mark.parametrize(
    ("argv", "code", "message"),
    [
        ([], 2, "required: VERB"),
        (["fly"], 2, "invalid choice: 'fly'"),
        (["import"], 2, "required: SOURCE, --store"),
        (["import", "no.tif", "--store", "x"], 1, "no.tif does not exist"),
        (["info", "nothing"], 1, "nothing does not exist"),
        (["bake", "--store", "x", "--max-error", "0", "--out", "a.ply"], 2, "0 is not more than 0"),
        (["bake", "--store", "x", "--max-error", "1", "--out", "a.doc"], 2, "no known format"),
        (["bake", "--store", "x", "--max-error", "1", "--displacement", "2", "--out", "a.npz"], 2, "--detail"),
        (["bake", "--store", "x", "--max-error", "1", "--detail", "0,2", "--out", "a.npz"], 2, "--detail"),
        (["bake", "--store", "x", "--max-error", "1", "--out", "a.npz"], 1, "no terrain store at x"),
        (
            ["maps", "--store", "x", "--maps", "sky", "--out", "maps"],
            1,
            "choose its folder (--store, or Store in Blender), or import again",
        ),
        (["export", "--frames", "1", "--format", "npz", "--out", "x"], 2, "--scene --store is required"),
        (["export", "--store", "x", "--frames", "1", "--format", "npz", "--out", "x"], 2, "needs --path"),
        (["export", "--store", "x", "--scatter", "--frames", "1", "--format", "npz", "--out", "x"], 2, "to --scene"),
        (["export", "--store", "x", "--frames", "5-1", "--format", "npz", "--out", "x"], 2, "go backwards"),
        (["export", "--store", "x", "--frames", "1", "--format", "doc", "--out", "x"], 2, "'doc' is unknown; expected"),
        (
            ["export", "--scene", "x", "--path", "y", "--frames", "1", "--format", "npz", "--out", "x"],
            2,
            "its own cameras",
        ),
        (["export", "--store", "x", "--path", "y", "--frames", "1", "--format", "npz", "--out", "x"], 1, "path y"),
    ],
)
def test_exit_codes(argv, code, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(argv) == code
    printed = capsys.readouterr()
    assert message in printed.err and printed.out == ""
    if code == 1:
        assert len(printed.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_frames_and_formats():
    assert parse_frames("7") == (7,)
    assert parse_frames("1-9:4") == (1, 5, 9)
    assert parse_frames("-2-1") == (-2, -1, 0, 1)
    assert parse_frames("-5--3") == (-5, -4, -3)
    assert parse_frames("1,3,7-20:2") == (1, 3, 7, 9, 11, 13, 15, 17, 19)
    assert parse_frames("9, 1-9:4,1-3") == (9, 1, 5, 2, 3), "in the order given, each once"
    with pytest.raises(TerrainError) as caught:
        parse_frames("4-2")
    assert caught.value.what == "The frames '4-2' go backwards or stand still" and "A-B:S" in caught.value.expected
    for text, wrong in (
        ("1,,3", "'' cannot be read"),
        ("1,4-2", "'4-2' go"),
        ("1,5;", "'5;' cannot be read"),
        ("2,9999999", "'9999999' are not within"),
    ):
        with pytest.raises(TerrainError, match=f"frames {wrong}"):
            parse_frames(text)
    with pytest.raises(TerrainError, match="too many; expected 1,000,000 at most"):
        parse_frames("0-999998,0-5")
    assert parse_formats("ply, npz,ply") == ("ply", "npz")
    for text in ("", "a", "3-1", "1-5:0", "1:2", "1,", "0-99999999"):
        with pytest.raises(TerrainError):
            parse_frames(text)


def test_progress_shows_the_time_left(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    bar = Progress(10, "export", show=True)
    bar.to(4, worked=False)
    assert bar.left_s() is None
    now[0] = 30.0
    bar.to(6)
    assert bar.left_s() == pytest.approx(60.0)
    bar.say("frame 6")
    bar.close()
    printed = capsys.readouterr()
    assert printed.out == "frame 6\n"
    assert " 60%  1:00 min left" in printed.err and printed.err.endswith("\r\x1b[K")


def test_a_farm_is_told_in_lines(capsys):
    bar = Progress(3, "export", show="openjd")
    bar.to(1)
    bar.to(1.001)
    bar.say("frame 6")
    bar.to(3)
    bar.close()
    printed = capsys.readouterr()
    told = ["openjd_progress: 0", "openjd_progress: 33", "openjd_status: frame 6", "openjd_progress: 100"]
    assert printed.out.splitlines() == told and printed.err == ""


def test_no_bar_where_no_terminal_is(capsys):
    bar = Progress(2, "export")
    bar.to(1)
    bar.close()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "0 s"), (59, "59 s"), (125, "2:05 min"), (3725, "1:02 h")])
def test_durations(seconds, text):
    assert duration(seconds) == text
