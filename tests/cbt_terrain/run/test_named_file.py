# SPDX-License-Identifier: GPL-3.0-or-later
"""Only one module opens files that a user names, and it waits for no pipe, socket or device."""

import ast
import os
import re
import socket
import subprocess
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import named_file
from forked_programs import start_program
from time_limit import time_limit

ROOT = Path(__file__).resolve().parents[3]
READS = {"read_text", "read_bytes", "np.load", "np.loadtxt", "np.genfromtxt", "np.fromfile"}
NAMES = {"open"} | {name.rpartition(".")[2] for name in READS}
A_CALL = re.compile(rf"\b({'|'.join(NAMES)})\b")  # to parse every module takes seconds
# Reads of files that no user names: of the system, of the package, or written just before; and a writer.
OWN = {
    ("cbt_terrain/field/store_arrays.py", "np.load(file, mmap_mode='r+')"),
    ("cbt_terrain/tiling/tile_work.py", "self.open(name)"),
    ("cbt_terrain/run/partial_files.py", "_BOOT.read_text()"),
    ("cbt_terrain/run/named_file.py", "Path(file).open('rb')"),
    ("cbt_terrain/formats/archives.py", "gzip.open(file)"),
    ("cbt_terrain/exporting/globe.py", "np.load(path)"),
    ("cbt_terrain/exporting/globe.py", "np.load(request['path'])"),
    ("cbt_terrain/exporting/height_tiles.py", "layer.form.open(partial, shape, layer.form.dtype, pool)"),
    ("cbt_terrain/height_operators/export.py", "np.fromfile(path, '<f4', count, offset=4 * first * shape.width)"),
    ("operators/farm/bundle.py", "(HERE / name).read_text(encoding='utf-8')"),
    ("operators/export/blender_exporters.py", "np.fromfile(file, face, faces)"),
    ("operators/text/machine.py", "open('/proc/cpuinfo', encoding='utf-8')"),
}


def make(kind: str, path: Path) -> Path:
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        socket.socket(socket.AF_UNIX).bind(str(path))
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "terminal":
        path.symlink_to("/dev/tty")
    elif kind == "folder":
        path.mkdir()
    return path


@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "terminal", "folder", "missing"])
def test_only_regular_files_are_opened(kind, tmp_path):
    path = make(kind, tmp_path / "x")
    with time_limit(10), pytest.raises(TerrainError) as error:
        named_file.read_named(path, "The points file", "CSV", 1000)
    why = {"folder": "Is a directory", "missing": "No such file or directory"}.get(kind, "it is not a regular file")
    assert str(error.value) == f"The points file {path} cannot be read ({why}); expected CSV."
    assert named_file.blocks_reader(path) == (kind not in ("folder", "missing"))


def test_a_file_is_read_to_its_limit_and_by_links_where_allowed(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert named_file.read_regular(tmp_path / "b", 5) == b"12345"
    with pytest.raises(ValueError, match="larger than 4 bytes"):
        named_file.read_regular(tmp_path / "a", 4)
    with pytest.raises(OSError, match="it is a link"):
        named_file.read_regular(tmp_path / "b", 5, links=False)


def test_the_standard_input_is_read_to_its_end():
    script = "from adaptive_terrain.cbt_terrain.run.named_file import read_named\n"
    script += "print(read_named('/dev/stdin', 'The file', 'text', 1 << 24, descriptors=True).decode())"
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    out, errors = start_program(script, text=True, **pipes).communicate("a" * 3_000_000)
    assert out == "a" * 3_000_000 + "\n" and errors == ""


def reads_of(path: Path) -> set[str]:
    """Return the calls in a module that open a file by its name for reading."""
    found, text = set(), path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)) if A_CALL.search(text) else ():
        if not isinstance(node, ast.Call):
            continue
        method = getattr(node.func, "attr", "")
        if (method or getattr(node.func, "id", "")) not in NAMES:  # to unparse every call takes seconds
            continue
        name = ast.unparse(node.func)
        if name in READS or method in READS:
            found.add(ast.unparse(node))
        elif name == "open" or (
            method == "open"
            and not name.startswith(("os.", "rasterio.", "memory.", "laspy.", "archive.", "webbrowser."))
        ):
            modes = [a.value for a in node.args[name == "open" :] if isinstance(a, ast.Constant)]
            if not modes or modes[0] in ("r", "rb"):
                found.add(ast.unparse(node))
    return found


def test_no_other_module_opens_files_for_reading():
    files = [path for house in ("kernels", "cbt_terrain", "operators") for path in (ROOT / house).rglob("*.py")]
    found = {(path.relative_to(ROOT).as_posix(), call) for path in files for call in reads_of(path)}
    assert {item for item in found if "os.devnull" not in item[1]} == OWN
