# SPDX-License-Identifier: GPL-3.0-or-later
"""Incomplete files are in a private folder, which is removed after its writer has ended in any way."""

import errno
import os
import signal
import subprocess
import sys
import threading

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import owned_files, partial_files
from adaptive_terrain.cbt_terrain.run.partial_files import remove_abandoned, sole_writer, written_beside

WRITE = """
import sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.run.partial_files import written_beside
with written_beside(Path(sys.argv[1])) as partial:
    partial.write_text("half")
    print(partial, flush=True)
    sys.stdin.read()
"""
posix = pytest.mark.skipif(os.name != "posix", reason="signals and modes are those of POSIX")


@pytest.fixture
def writer(tmp_path):
    """Start a process in the middle of writing tmp_path / "a.txt" to the path in `partial`."""
    command = [sys.executable, "-c", WRITE, str(tmp_path / "a.txt")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    process.partial = tmp_path / process.stdout.readline().rstrip("\n")
    yield process
    process.kill()
    process.communicate()


def test_what_is_being_written_stays_until_its_writer_is_killed(writer, tmp_path):
    remove_abandoned(tmp_path)
    assert writer.partial.read_text() == "half"
    writer.kill()
    writer.wait()
    remove_abandoned(tmp_path)
    assert list(tmp_path.iterdir()) == []


@posix
def test_a_writer_that_stands_still_for_days_is_alive(writer, tmp_path):
    """A number of a process, or a time, would not tell."""
    writer.send_signal(signal.SIGSTOP)
    for path in (writer.partial, writer.partial.parent):
        os.utime(path, (0, 0))
    remove_abandoned(tmp_path)
    assert writer.partial.exists()
    writer.send_signal(signal.SIGCONT)
    writer.communicate()
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_what_another_machine_has_left_goes_after_a_day(writer, tmp_path, monkeypatch):
    """There its lock may not be seen."""
    writer.kill()
    writer.wait()
    monkeypatch.setattr(partial_files, "_machine", lambda: "0" * 8)
    remove_abandoned(tmp_path)
    assert writer.partial.exists()
    for path in (writer.partial, writer.partial.with_name("lock"), writer.partial.parent):
        os.utime(path, (0, 0))
    remove_abandoned(tmp_path)
    assert list(tmp_path.iterdir()) == []


@posix
def test_no_link_in_a_shared_folder_leads_elsewhere(tmp_path, monkeypatch):
    """Links neither in the place of new files nor of removed ones are followed."""
    shared, private = tmp_path / "shared", tmp_path / "private"
    shared.mkdir()
    private.mkdir()
    (private / "diary").write_text("mine")
    token = partial_files.new_token()
    (shared / f".partial-{token}").symlink_to(private)
    remove_abandoned(shared)
    assert [path.name for path in private.iterdir()] == ["diary"]
    monkeypatch.setattr(partial_files, "new_token", lambda: token)
    with pytest.raises(FileExistsError), written_beside(shared / "a.txt"):
        pass
    monkeypatch.undo()
    with written_beside(shared / "a.txt") as partial:
        assert partial.parent.stat().st_mode & 0o777 == 0o700 and partial.name == "a.txt"
        partial.write_text("x")
    assert [path.name for path in private.iterdir()] == ["diary"]
    fake = shared / f".partial-{partial_files.new_token()}"
    fake.mkdir()
    (fake / "lock").symlink_to(private / "diary")
    os.mkfifo(fake / "pipe")
    remove_abandoned(shared)
    assert (private / "diary").read_text() == "mine"


def test_a_failed_or_empty_write_leaves_the_old_file(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ValueError), written_beside(tmp_path / "a.txt") as partial:
        partial.write_text("new")
        raise ValueError
    with pytest.raises(FileNotFoundError), written_beside(tmp_path / "a.txt"):
        pass  # wrote nothing
    assert (tmp_path / "a.txt").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


@posix
@pytest.mark.parametrize("written", [written_beside, partial_files.written_among])
def test_no_device_and_no_folder_is_replaced(tmp_path, written):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "to_pipe").symlink_to(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    before = {path.name: path.lstat().st_ino for path in tmp_path.iterdir()}
    for name, kind in (("pipe", FileExistsError), ("to_pipe", FileExistsError), ("folder", IsADirectoryError)):
        with pytest.raises(kind) as refused, written(tmp_path / name) as partial:
            partial.touch()
        assert refused.value.strerror in ("a device or a pipe is there", os.strerror(errno.EISDIR))
    assert {path.name: path.lstat().st_ino for path in tmp_path.iterdir()} == before


def test_users_read_final_names(tmp_path):
    with written_beside(tmp_path / "a.txt") as partial:
        assert partial_files.final_names(f"no room for '{partial}'") == f"no room for '{tmp_path / 'a.txt'}'"
        partial.touch()


@posix
def test_files_of_killed_writers_beside_the_folder_are_removed(tmp_path):
    token = partial_files.new_token()
    for name in (f".partial-{token}-a.blend", f".partial-{token}-a.blend@", f".partial-{'0' * 32}-b.blend", "a.blend"):
        (tmp_path / name).write_text("half")
    (tmp_path / f".partial-{token}").mkdir()
    (tmp_path / f".partial-{token}" / "lock").touch()
    with partial_files.written_among(tmp_path / "c.blend") as alive:
        assert alive.parent == tmp_path
        alive.touch()
        remove_abandoned(tmp_path)
        assert alive.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f".partial-{'0' * 32}-b.blend", "a.blend", "c.blend"]


@pytest.mark.thorough
def test_writers_and_removers_side_by_side(tmp_path):
    """Each write succeeds while other processes remove abandoned folders."""
    done = threading.Event()

    def look():
        while not done.is_set():
            remove_abandoned(tmp_path)

    threads = [threading.Thread(target=look) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        for i in range(300):
            with written_beside(tmp_path / "a.txt") as partial:
                partial.write_text(str(i))
            assert (tmp_path / "a.txt").read_text() == str(i)
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert len(list(tmp_path.iterdir())) == 1


HOLD = """
import sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.run.partial_files import sole_writer
with sole_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_files_of_one_name_have_one_writer_until_it_ends(tmp_path):
    path = tmp_path / "a.json"
    command = [sys.executable, "-c", HOLD, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        remove_abandoned(tmp_path)  # by another export into the folder
        for name in ("a.json", "A.JSON"):
            with pytest.raises(TerrainError, match="being written by another export: wait for its end"):
                with sole_writer(tmp_path / name):
                    pass
        with sole_writer(tmp_path / "b.json"):
            pass
        process.kill()
    assert len(list(tmp_path.iterdir())) == 1, "a killed writer leaves its folder"
    with sole_writer(path):
        pass
    assert list(tmp_path.iterdir()) == []


@posix
def test_a_lock_is_removed_before_its_release(tmp_path, monkeypatch):
    """Otherwise a writer that has just taken it would have none, and a third one would take a new one."""
    remove, removed = owned_files.remove_tree, []

    def remove_held(folder, **options):
        assert partial_files.is_in_use(folder)
        remove(folder, **options)
        removed.append(folder)

    monkeypatch.setattr(owned_files, "remove_tree", remove_held)
    with sole_writer(tmp_path / "a.json"):
        pass
    assert len(removed) == 1 and list(tmp_path.iterdir()) == []
