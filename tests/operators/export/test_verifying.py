# SPDX-License-Identifier: GPL-3.0-or-later
"""`verify` names each frame that is missing, damaged, stale or of another scene; `--resume` reads the same summary."""

import json
import os

import pytest
from adaptive_terrain.operators.export import summaries
from adaptive_terrain.operators.export.summaries import (
    close_summary,
    content_digest,
    find_complete_summary,
    summary_checksum,
)
from store_exports import run

FIGURES = {"name": "a", "triangles": 5, "limited": "", "ms": {"total": 1.0}, **dict.fromkeys(summaries.BOUNDS)}
FIGURES["bound_px"] = 1.0


@pytest.fixture
def frames(tmp_path):
    """Write three frames, made of one image in the parent folder, into a folder."""
    (tmp_path / "tex.png").write_bytes(b"red")
    out = tmp_path / "out"
    out.mkdir()
    for frame in (4, 5, 6):
        (out / f"a_{frame:04d}.npz").write_bytes(b"12%d" % frame)
        write_summary(out, frame)
    return out


def write_summary(out, number, **changed) -> None:
    """Write the summary of a frame with the right digests, for these values."""
    summary = {"frame": number, "settings": "a", "inputs": {"../tex.png": content_digest(out.parent / "tex.png")}}
    summary |= {"files": {f"a_{number:04d}.npz": 3}, "terrains": [FIGURES], "elapsed_ms": 1.0} | changed
    (out / f"frame_{number:04d}.json").write_text(json.dumps(close_summary(summary, out)))


def edit(out, with_checksum=False, **changed) -> None:
    """Change frame 6's summary, and its checksum or not."""
    path = out / "frame_0006.json"
    summary = json.loads(path.read_text()) | changed
    path.write_text(json.dumps(summary | ({"checksum": summary_checksum(summary)} if with_checksum else {})))


def replace(out, make) -> None:
    """Put something else in the place of frame 6's summary."""
    path = out / "frame_0006.json"
    content = path.read_bytes()
    path.unlink()
    make(path, content)


def link(path, content) -> None:
    path.with_name("elsewhere.json").write_bytes(content)
    path.symlink_to("elsewhere.json")


HUGE = 10**400
SUMMARY_DAMAGE = {
    "empty": lambda out: replace(out, lambda path, _: path.write_bytes(b"")),
    "truncated": lambda out: replace(out, lambda path, content: path.write_bytes(content[: len(content) // 2])),
    "no JSON": lambda out: replace(out, lambda path, _: path.write_bytes(b"\xff\x00 not JSON")),
    "no object": lambda out: replace(out, lambda path, _: path.write_text("[]")),
    "a number": lambda out: replace(out, lambda path, _: path.write_text("7")),
    "no members": lambda out: replace(out, lambda path, _: path.write_text("{}")),
    "deep nesting": lambda out: replace(out, lambda path, _: path.write_text("[" * 100_000)),
    "deep objects": lambda out: replace(out, lambda path, _: path.write_text('{"a":' * 50_000 + "1" + "}" * 50_000)),
    "huge number": lambda out: replace(out, lambda path, _: path.write_text('{"frame": ' + "9" * 10_000 + "}")),
    "too large": lambda out: replace(out, lambda path, content: path.write_bytes(content + b" " * (1 << 24))),
    "a pipe": lambda out: replace(out, lambda path, _: os.mkfifo(path)),
    "a folder": lambda out: replace(out, lambda path, _: path.mkdir()),
    "a link": lambda out: replace(out, link),
    "a broken link": lambda out: replace(out, lambda path, _: path.symlink_to("nothing")),
    "a changed figure": lambda out: edit(out, terrains=[FIGURES | {"triangles": 6}]),
    "a missing member": lambda out: write_summary(out, 6, terrains=[{"triangles": 5}]),
    "another frame": lambda out: write_summary(out, 6, frame=5),
    "a frame in quotes": lambda out: write_summary(out, 6, frame="6"),
    "a frame that is true": lambda out: write_summary(out, 6, frame=True),
    "no files": lambda out: write_summary(out, 6, files={}),
    "endless size": lambda out: write_summary(out, 6, files={"a_0006.npz": 1e999}),
    "negative size": lambda out: write_summary(out, 6, files={"a_0006.npz": -3}),
    "triangles in quotes": lambda out: write_summary(out, 6, terrains=[FIGURES | {"triangles": "x"}]),
    "bound in quotes": lambda out: write_summary(out, 6, terrains=[FIGURES | {"bound_px": "x"}]),
    "huge bound": lambda out: write_summary(out, 6, terrains=[FIGURES | {"bound_px": HUGE}]),
    "huge time": lambda out: write_summary(out, 6, elapsed_ms=HUGE),
    "unknown limit": lambda out: write_summary(out, 6, terrains=[FIGURES | {"limited": "x"}]),
    "terrains by name": lambda out: write_summary(out, 6, terrains={"a": FIGURES}),
}


@pytest.mark.parametrize("damage", SUMMARY_DAMAGE)
def test_a_damaged_summary_means_another_rendering(frames, capsys, damage):
    digests = {"../tex.png": content_digest(frames.parent / "tex.png")}
    assert find_complete_summary(frames, 6, "a", digests, ("npz",)) is not None
    SUMMARY_DAMAGE[damage](frames)
    assert find_complete_summary(frames, 6, "a", digests, ("npz",)) is None
    assert run("verify", frames, "--frames", "4-6") == 1
    said = capsys.readouterr().err
    assert "frame 6: frame_0006.json is damaged" in said or (damage == "a broken link" and "frame 6 is missing" in said)
    assert said.count("\n") == 1 and "frame 5" not in said


FILE_DAMAGE = {
    "frame 6 is missing": lambda out: (out / "frame_0006.json").unlink(),
    "frame 6: a_0006.npz is missing": lambda out: (out / "a_0006.npz").unlink(),
    "frame 6: a_0006.npz is cut short": lambda out: (out / "a_0006.npz").write_bytes(b"12"),
    "frame 6: a_0006.npz is too long": lambda out: (out / "a_0006.npz").write_bytes(b"1264"),
    "frame 6: a_0006.npz has another content": lambda out: (out / "a_0006.npz").write_bytes(
        (out / "a_0005.npz").read_bytes()
    ),
    "frame 6: a? is missing": lambda out: edit(out, True, files={"a\0": 3}, digests={"a\0": "00"}),
    "frame 6 is stale: ../tex.png has changed": lambda out: write_summary(out, 6, inputs={"../tex.png": "00"}),
    "frame 4 is stale: ../tex.png has changed": lambda out: (out.parent / "tex.png").write_bytes(b"blu"),
    "frame 6 was made of another scene": lambda out: write_summary(out, 6, settings="b"),
}


@pytest.mark.parametrize("fault", FILE_DAMAGE)
def test_each_fault_is_named_with_its_frame(frames, capsys, fault):
    assert run("verify", frames, "--frames", "4-6", "--progress", "openjd") == 0
    assert "3 frames are whole, 15 triangles, largest bound 1 px" in capsys.readouterr().out
    FILE_DAMAGE[fault](frames)
    assert run("verify", frames, "--frames", "4-6", "--progress", "openjd") == 1
    said = capsys.readouterr()
    assert fault in said.err and said.out.splitlines()[-1].startswith("openjd_fail: ") and fault in said.out


def test_missing_frames_are_named_as_ranges(frames, capsys):
    """With the syntax of --frames, to make them again."""
    for frame in (4, 5):
        (frames / f"frame_{frame:04}.json").unlink()
    assert run("verify", frames, "--frames", "2-9,20,30-40:5") == 1
    assert "is not complete: frames 2-5,7-9,20,30-40:5 are missing: make those" in capsys.readouterr().err


def test_missing_inputs_are_counted_and_not_compared(frames, capsys):
    (frames.parent / "tex.png").unlink()
    assert run("verify", frames, "--frames", "4-6") == 0
    assert "1 of the files that they were made of are not here" in capsys.readouterr().out


def test_an_input_with_an_impossible_name_is_missing(frames, capsys):
    write_summary(frames, 6, inputs={f"../{'n' * 300}.png": None})
    assert run("verify", frames, "--frames", "6") == 0
    assert "1 of the files that they were made of are not here" in capsys.readouterr().out


def test_frames_stay_complete_in_another_place(frames, tmp_path):
    digests = {"../tex.png": content_digest(tmp_path / "tex.png")}
    moved = tmp_path / "elsewhere" / "deeper"
    moved.parent.mkdir()
    frames.rename(moved)
    assert find_complete_summary(moved, 6, "a", {"../../far/tex.png": digests["../tex.png"]}, ()) is not None
    assert find_complete_summary(moved, 6, "a", {"../../far/rock.png": digests["../tex.png"]}, ()) is None
    assert find_complete_summary(moved, 6, "a", {}, ()) is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_has_no_content_and_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "tex.png")
    assert content_digest(tmp_path / "tex.png") is content_digest(tmp_path) is content_digest("a\0") is None
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "a").write_bytes(b"a")
    assert content_digest(tmp_path / "link") == content_digest(tmp_path / "a") is not None


@pytest.mark.parametrize("damage", ["truncated", "no object", "deep nesting", "too large", "a pipe", "a link"])
def test_a_frame_with_a_damaged_summary_is_exported_again(export, damage):
    resumed = "--frames", "6", "--format", "npz", "--resume"
    _, _, out = export("--frames", "6", "--format", "npz")
    before = (out / "terrain_0006.npz").read_bytes()
    assert "complete before" in export(*resumed)[1].out
    SUMMARY_DAMAGE[damage](out)
    code, said, _ = export(*resumed)
    assert code == 0 and "complete before" not in said.out and said.err == ""
    assert not (out / "frame_0006.json").is_symlink() and (out / "frame_0006.json").is_file()
    assert "complete before" in export(*resumed)[1].out and (out / "terrain_0006.npz").read_bytes() == before
    if damage == "a link":
        assert json.loads((out / "elsewhere.json").read_text())["frame"] == 6, "what it led to is left alone"


def test_a_folder_in_the_place_of_a_summary_is_refused(export):
    (export("--frames", "1", "--format", "npz")[2] / "frame_0006.json").mkdir()
    code, said, _ = export("--frames", "6", "--format", "npz", "--resume")
    assert code == 1 and "frame_0006.json" in said.err and said.err.count("\n") == 1
