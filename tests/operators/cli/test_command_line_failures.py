# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line on bad input and in bad circumstances: one clear sentence, and nothing half-done."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators.export import export_raster
from adaptive_terrain.operators.cli import command_line
from forked_programs import COMMAND_LINE, run_program
from store_exports import run

BAKE = ["bake", "--store", "x", "--out", "a.npz"]
EXPORT = ["export", "--store", "x", "--path", "y", "--format", "npz", "--out", "x"]


posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX shells, pipes and descriptors")


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([*BAKE, "--max-error", "nan"], "nan is not more than 0"),
        ([*BAKE, "--max-error", "inf"], "inf is more than 1e+09"),
        ([*BAKE, "--max-error", "1", "--budget", "-1"], "-1 is not within 0"),
        ([*EXPORT, "--frames", "1", "--pixel-error", "-1"], "-1 is not a finite number, 0 or more"),
        ([*EXPORT, "--frames", "1", "--pixel-error", "nan"], "nan is not a finite number, 0 or more"),
        ([*EXPORT, "--frames", "1", "--metres", "inf"], "inf is not a finite number, 0 or more"),
        ([*EXPORT, "--frames", "1", "--budget", "99999999999"], " is not a whole number from 0 to 2,147,483,647"),
        ([*EXPORT, "--frames", "1", "--meshlet", "5"], "5 is not a whole number from 0 to 4"),
        ([*EXPORT, "--frames", "1", "--resolution", "65537x1"], "'65537x1' has a number above 65536"),
        ([*EXPORT, "--frames", "1", "--resolution", "0x10"], "'0x10' is not two numbers above 0"),
        ([*EXPORT, "--frames", "1048575"], "not within"),
        ([*EXPORT, "--frames", "-1048575-1:1000"], "not within"),
        ([*EXPORT, "--frames", "9" * 5000], "frames"),
        (["import", "island", "--store", ""], "the name is empty"),
        (["import", "island", "--store", "x", "--extent", "infx1"], "has a number above"),
        (["import", "dem.tif", "--store", "x", "--size", "100"], "(--size, --seed) has no effect on dem.tif; expected"),
        (["import", "dem.npy", "--store", "x", "--band", "2"], "dem.npy; expected one of .tif, .tiff, .hgt, .png"),
        (["import", "island", "--store", "x", "--band", "1"], "A band (--band) has no effect on island; expected one"),
        (["import", "island", "--store", "x", "--holes"], "(--no-data, --holes) has no effect on island; expected"),
        (["import", "dem.tif", "--store", "x", "--channel", "Z"], "(--channel) has no effect on dem.tif; expected one"),
        (["import", "dem.tif", "--store", "x", "--raw-size", "9x9"], "has no effect on dem.tif; expected one of .raw,"),
        (["import", "dem.tif", "--store", "x", "--raw-type", "uint16"], "--raw-type, --big-endian) has no effect on"),
        (["import", "a.tif", "b.tif", "--store", "x", "--first-row-south"], "a.tif and 1 more; expected one file that"),
        (["info", "mesh.npz", "--project", "utm"], "mesh.npz is no height map, so it has no options of an import"),
        (["submit", "--scene", "s.blend", "--out", "job", "--frames", "1", "--chunk", "0"], "0 is not 1 or more"),
        ([*BAKE, "--max-error", "2m"], "'2m' is not a number"),
        ([*BAKE, "--max-error", "1", "--budget", "1.5"], "'1.5' is not a whole number"),
    ],
)
def test_numbers_out_of_range_are_wrong_usage(argv, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if "--frames" in argv:  # a value that starts with a minus sign needs the equals sign
        at = argv.index("--frames")
        argv = [*argv[:at], f"--frames={argv[at + 1]}", *argv[at + 2 :]]
    assert command_line.main(argv) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_engine_is_imported_where_an_interruption_is_caught():
    script = "import sys, adaptive_terrain.operators.cli.command_line; sys.exit('warp' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


@pytest.mark.parametrize("words", [[], ["--json"], ["verify"]], ids=["help", "option", "verb"])
def test_help_imports_only_what_its_verb_needs(words):
    script = "import sys; from adaptive_terrain.operators.cli.command_line import main; "
    script += f"code = main({[*words, '--help']!r}); sys.exit(code or 'warp' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


def test_an_interruption_is_one_line(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command_line, "build_parser", interrupted)
    assert command_line.main(["info", "x"]) == 130
    assert capsys.readouterr().err == "adaptive-terrain: stopped\n"


@pytest.mark.parametrize("form", ["npz", "ply", "obj", "glb", "stl", "blend"])
def test_what_cannot_be_written_is_one_sentence(store, tmp_path, capfd, form):
    if form != "npz":
        pytest.importorskip("bpy")
    long_name = "n" * 256 + f".{form}"  # more than file systems take
    for out, status, message in (
        (tmp_path / "missing" / f"a.{form}", 1, "There is no folder"),
        (Path(store) / "store.json" / f"a.{form}", 1, "is a file; expected a folder"),
        (tmp_path / long_name, 2, "holds a name of"),
    ):
        assert run("bake", "--store", store, "--max-error", "9", "--out", out) == status
        said = capfd.readouterr().err.splitlines()
        assert message in said[-1] and ".partial" not in said[-1] and "Traceback" not in "".join(said), said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("part", ["", "data", "data/new", "tiles", "link"])
def test_outputs_in_the_folders_of_a_store_are_refused(store, tmp_path, capsys, part):
    copy = tmp_path / "copy"
    shutil.copytree(store, copy)
    arrays = json.loads((copy / "store.json").read_text())["data"]
    (tmp_path / "link").symlink_to(copy / arrays)
    out = tmp_path / "link" if part == "link" else copy / part.replace("data", arrays)
    if not part.endswith("new"):
        out.mkdir(exist_ok=True)
    before = sorted(tmp_path.rglob("*"))
    (tmp_path / "points.csv").write_text("x,y\n0,0\n")
    for argv in (
        ["tiles", "--out", out],
        ["bake", "--max-error", "9", "--out", out / "a.npz"],
        ["tileset", "--max-error", "9", "--out", out / "a.json"],
        ["maps", "--maps", "slope", "--out", out],
        ["query", "--points", tmp_path / "points.csv", "--out", out / "heights.csv"],
        ["accuracy", "--out", out],
    ):
        assert run(*argv, "--store", copy) == 1
        said = capsys.readouterr().err
        missing = part.endswith("new") and "There is no folder" in said
        assert missing or "belongs to a terrain store: choose another folder" in said
    with pytest.raises(TerrainError, match="belongs to a terrain store|here is no folder"):
        export_raster(copy, out / "heights.exr")
    (tmp_path / "points.csv").unlink()
    assert sorted(tmp_path.rglob("*")) == before


def test_outputs_beside_and_below_a_store_are_written(store, tmp_path):
    """A project may have its store at the top."""
    shutil.copytree(store, tmp_path, dirs_exist_ok=True)
    (tmp_path / "out").mkdir()
    assert run("bake", "--store", tmp_path, "--max-error", "9", "--out", tmp_path / "out" / "a.npz") == 0
    assert (tmp_path / "out" / "a.npz").exists()


def test_terrains_of_one_file_name_are_refused(scene, add_terrain, tmp_path, capsys):
    import bpy

    add_terrain("A/B")
    add_terrain("a_b")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    out = tmp_path / "out"
    assert run("export", "--scene", tmp_path / "scene.blend", "--frames", "1", "--format", "npz", "--out", out) == 1
    said = capsys.readouterr().err
    assert "'A/B'" in said and "'a_b'" in said and "rename" in said
    assert not out.exists()


def test_resume_sees_a_new_height_map_and_a_changed_library(scene, add_terrain, tmp_path, capsys):
    import bpy

    def rebuild(path, height):
        samples = np.full((9, 9), height, np.float32)
        samples[4, 4] += 5
        np.save(tmp_path / "map.npy", samples)
        assert run("import", tmp_path / "map.npy", "--store", path) == 0

    rebuild(tmp_path / "map.store", 1.0)
    add_terrain().adaptive_terrain.store = str(tmp_path / "map.store")
    library = tmp_path / "library.blend"
    rig = bpy.data.objects.new("Rig", None)
    bpy.data.libraries.write(str(library), {rig})
    bpy.data.objects.remove(rig)
    with bpy.data.libraries.load(str(library), link=True) as (_there, here):
        here.objects = ["Rig"]
    scene.collection.objects.link(here.objects[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    argv = ["export", "--scene", tmp_path / "scene.blend", "--frames", "1", "--format", "npz", "--resume"]

    def complete():
        capsys.readouterr()
        assert run(*argv, "--out", tmp_path / "out") == 0
        return "complete before" in capsys.readouterr().out

    assert [complete(), complete()] == [False, True]
    rebuild(tmp_path / "map.store", 2.0)
    assert [complete(), complete()] == [False, True]
    moved = bpy.data.objects.new("Rig", None)
    moved.location.x = 5.0
    moved.name = "Rig"
    bpy.data.libraries.write(str(library), {moved})
    assert [complete(), complete()] == [False, True]


def test_a_clean_up_that_leaves_nothing_is_told(scene, add_terrain, tmp_path, capsys):
    import bpy

    cleanup = add_terrain("Hills").adaptive_terrain.cleanup
    cleanup.use_below, cleanup.below = True, 1e5
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    argv = ["export", "--scene", tmp_path / "scene.blend", "--frames", "1", "--format", "npz,ply,stl,glb,obj"]
    code = run(*argv, "--out", tmp_path / "out")
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "frame 1: 0 triangles" in said.out and "nothing is left of Hills" in said.out


LATE = """
import os, signal, sys, time
from adaptive_terrain.operators.cli import command_line, import_verbs
def late(*_):
    signal.raise_signal(number)
    time.sleep(0.1)
import_verbs.run_info = late
sys.argv[1:] = ["info", "x"]
command_line.build_parser()  # imports the engine once for both
for number in (signal.SIGINT, signal.SIGTERM):
    if os.fork() == 0:
        command_line.program()
    assert os.wait()[1] == 0, number
"""


@posix
def test_a_signal_after_the_last_step_changes_nothing():
    ended = run_program(LATE)
    assert (ended.returncode, ended.stderr) == (0, "")


def printed(store: str, **streams) -> subprocess.CompletedProcess:
    """Run `query` with other standard streams in a new process that buffers as Python does by default."""
    points = Path(store).parent / "two_points.csv"
    points.write_text("x,y\n0,0\n5,5\n")
    return run_program(COMMAND_LINE, "query", "--store", store, "--points", str(points), **streams)


@posix
def test_stdout_that_takes_no_more_is_one_sentence(store):
    read_end, unread = os.pipe()
    os.close(read_end)
    for stdout, why in ((os.open("/dev/full", os.O_WRONLY), "No space left on device"), (unread, "Broken pipe")):
        done = printed(store, stdout=stdout)
        os.close(stdout)
        told = done.stderr.splitlines()
        assert len(told) == 2 and told[0].startswith("2 places"), told
        assert told[1].startswith(f"adaptive-terrain: error: stdout cannot be written ({why})"), told
        assert done.returncode == 1


@posix
def test_closed_streams_lead_nowhere(store):
    heard = printed(store, closed=(1,))
    assert heard.returncode == 0 and len(heard.stderr.splitlines()) == 1, heard.stderr
    table = printed(store, closed=(2,))
    assert table.returncode == 0 and len(table.stdout.splitlines()) == 3, "the line about it is not in the table"
    assert printed(store, closed=(0, 1, 2)).returncode == 0


@posix
def test_a_name_that_the_terminal_lacks_is_shown_in_escapes(tmp_path):
    command = ["import", "island", "--size", "65", "--store", str(tmp_path / "река")]
    done = run_program(COMMAND_LINE, *command, encoding="ascii")
    assert done.returncode == 0 and "\\u0440" in done.stdout.splitlines()[-1], done.stderr


def test_an_error_is_one_line_whatever_a_name_holds(tmp_path, capsys):
    assert run("info", tmp_path / "a\nb\x1b[2Jc.store") == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "\x1b" not in said and "a b?[2Jc.store" in said


@posix
def test_no_pipe_is_replaced_by_an_output(store, tmp_path, capfd):
    points, stack = tmp_path / "points.csv", tmp_path / "stack.json"
    points.write_text("x,y\n0,0\n")
    stack.write_text('{"version": 1, "entries": []}')
    made = {name: tmp_path / name for name in ("a.npz", "a.csv", "a.tif")}
    for path in made.values():
        os.mkfifo(path)
    for argv in (
        ["bake", "--store", store, "--max-error", "9", "--out", made["a.npz"]],
        ["query", "--store", store, "--points", points, "--out", made["a.csv"]],
        ["shape", "--store", store, "--stack", stack, "--out", tmp_path / "new.store", "--export", made["a.tif"]],
    ):
        assert run(*argv) == 1
        (said,) = capfd.readouterr().err.splitlines()
        assert "a device or a pipe" in said, said
    assert all(path.is_fifo() for path in made.values()) and not (tmp_path / "new.store").exists()


def test_what_the_system_refuses_is_one_sentence(store, tmp_path, capsys):
    taken, path = tmp_path / "out" / "frame_0001.json", tmp_path / "path.json"
    taken.mkdir(parents=True)
    path.write_text('{"keyframes": [{"frame": 1, "eye": [0, -900, 400], "target": [0, 0, 0]}]}')
    where = ["--path", path, "--frames", "1", "--format", "npz", "--out", taken.parent]
    assert run("export", "--store", store, *where) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"adaptive-terrain: error: {taken} is a folder; expected a file") and said.count("\n") == 1


def test_json_prints_the_fields_of_an_error(tmp_path, capsys):
    missing = tmp_path / "none.store"
    assert run("--json", "info", missing) == 1
    fields = json.loads(capsys.readouterr().err)
    assert str(missing) in fields["what"] and fields["expected"] == "the file of a height map"


@pytest.mark.parametrize("words", [["none"], [], ["bake", "--max-error", "0"], ["info"]])
def test_json_prints_wrong_usage_as_json(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("--json", *words) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and json.loads(printed.err)["what"]
    assert run(*words) == 2 and "error: " in capsys.readouterr().err.splitlines()[-1]


def test_a_long_description_is_whole_json(tmp_path, capsys, monkeypatch):
    name = "s" * 20_000
    monkeypatch.setattr("adaptive_terrain.operators.cli.import_verbs._described", lambda *_: {"crs": name})
    assert run("info", "--json", tmp_path) == 0
    assert json.loads(capsys.readouterr().out) == {"crs": name}


def test_too_little_memory_is_one_line(monkeypatch, capsys):
    def allocate(_arguments):
        raise MemoryError("Unable to allocate 10.2 MiB")

    monkeypatch.setattr("adaptive_terrain.operators.cli.verbs.run_effects", allocate)
    assert run("effects") == 1
    said = capsys.readouterr().err
    assert "memory does not suffice (Unable to allocate 10.2 MiB)" in said and said.count("\n") == 1
    assert run("--json", "effects") == 1 and "memory" in json.loads(capsys.readouterr().err)["what"]
