# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiled kernels survive damaged, full, unwritable and missing caches."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import kernel_cache

FOLDER = "import adaptive_terrain.kernels, warp; print(warp.config.kernel_cache_dir)"
# Loads the module that is compiled fastest, and prints where it is kept.
LOAD = """
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.kernels.field import fill
try:
    warmup.load(fill)
except TerrainError as error:
    print(error)
else:
    print(warmup.compiled_file(fill))
"""
# The cache becomes a file after Warp has started.
SPOILT = (
    "import os, warp, adaptive_terrain.kernels\ncache = warp.config.kernel_cache_dir\nos.rmdir(cache)\nopen(cache, 'w')"
)
# No file may be larger than 100 kB: as on a full disk, no object fits anywhere.
FULL = "import resource, signal\nresource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
FULL += "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)"
UNSET = {"WARP_CACHE_PATH": None, "XDG_CACHE_HOME": None}
posix = pytest.mark.skipif(os.name != "posix", reason="homes and limits are those of POSIX")


def run(script: str, cwd: Path, **variables: str | None) -> str:
    """Run a script in a new process; returns its last line."""
    environment = {k: v for k, v in (os.environ | variables).items() if v is not None}
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stderr, (done.stdout, done.stderr)
    return done.stdout.splitlines()[-1]


@pytest.mark.thorough
def test_a_damaged_object_is_compiled_anew(tmp_path):
    file = Path(run(LOAD, tmp_path, WARP_CACHE_PATH=str(tmp_path)))
    good = file.read_bytes()
    file.write_bytes(good[:1500] + b"\xff\xff\xff" + good[1503:])
    damaged = file.stat().st_mtime_ns
    assert Path(run(LOAD, tmp_path, WARP_CACHE_PATH=str(tmp_path))) == file
    assert file.read_bytes() == good
    times = [path.stat().st_mtime_ns for path in file.parent.iterdir()]
    assert len(times) == 4 and min(times) > damaged and len(list(file.parents[1].iterdir())) == 1
    run(LOAD, tmp_path, WARP_CACHE_PATH=str(tmp_path))
    assert times == [path.stat().st_mtime_ns for path in file.parent.iterdir()], "a whole one is not compiled again"


def built(folder: Path, content: bytes) -> Path:
    """Make what Warp compiles of the module "m"."""
    folder.mkdir(parents=True)
    (folder / "m.cpu1.o").write_bytes(content)
    (folder / "m.meta").write_text("{}")
    (folder / "m.cpp").write_text("int m;")
    return folder


def test_any_damage_of_a_compiled_module_is_noticed(tmp_path):
    file = tmp_path / "m" / "m.cpu1.o"
    kernel_cache._publish(built(tmp_path / "new" / "m", bytes(range(256))), file)
    assert kernel_cache._is_whole(file) and not list((tmp_path / "new").iterdir())
    for path in (file, file.with_name("m.meta"), file.with_name("m.cpu1.checksum")):
        good = path.read_bytes()
        for bad in (b"", good[:-1], good + b"x", bytes([good[0] ^ 1]) + good[1:], os.urandom(len(good))):
            path.write_bytes(bad)
            assert not kernel_cache._is_whole(file), (path.name, bad)
        path.unlink()
        assert not kernel_cache._is_whole(file), path.name
        path.mkdir()
        assert not kernel_cache._is_whole(file), path.name
        path.rmdir()
        path.write_bytes(good)
    assert kernel_cache._is_whole(file)


def test_a_module_replaces_what_is_in_the_cache(tmp_path):
    """Publish over a damaged object, next to that of another processor."""
    file = tmp_path / "m" / "m.cpu1.o"
    built(file.parent, b"damaged")
    (file.parent / "m.cpu2.o").write_bytes(b"of another processor")
    kernel_cache._publish(built(tmp_path / "new" / "m", b"good"), file)
    assert (
        kernel_cache._is_whole(file) and file.read_bytes() == b"good" and not list((tmp_path / "new" / "m").iterdir())
    )
    assert (file.parent / "m.cpu2.o").read_bytes() == b"of another processor"


def unusable_caches(folder: Path):
    """Yield variables of environments in which no cache can be used."""
    (folder / "file").write_text("")
    yield {"WARP_CACHE_PATH": str(folder / "file")}
    yield {"WARP_CACHE_PATH": "/dev/null"}
    yield UNSET | {"XDG_CACHE_HOME": str(folder / "file")}
    yield UNSET | {"HOME": "/proc/nowhere"}
    yield UNSET | {"HOME": "relative"}


@pytest.mark.thorough
@posix
def test_an_unusable_cache_is_replaced_by_a_temporary_one(tmp_path):
    work = tmp_path / "work"
    work.mkdir()
    for variables in unusable_caches(tmp_path):
        cache = Path(run(FOLDER, work, TMPDIR=str(tmp_path), **variables))
        assert cache.parent.name.startswith("adaptive_terrain_kernels_"), variables
        assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "work"] and not list(work.iterdir())


@posix
def test_a_relative_cache_home_is_ignored(tmp_path):
    cache = run(FOLDER, tmp_path, **UNSET | {"XDG_CACHE_HOME": "relative", "HOME": str(tmp_path)})
    assert Path(cache).parent == tmp_path / ".cache" / "warp"
    assert [path.name for path in tmp_path.iterdir()] == [".cache"]


@pytest.mark.thorough
@posix
def test_a_cache_that_fails_later_is_replaced(tmp_path):
    file = Path(run(f"{SPOILT}\n{LOAD}", tmp_path, WARP_CACHE_PATH=str(tmp_path / "cache"), TMPDIR=str(tmp_path)))
    assert file.parents[2].name.startswith("adaptive_terrain_kernels_")
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


@posix
def test_no_room_at_all_is_one_clear_error(tmp_path):
    error = run(f"{FULL}\n{LOAD}", tmp_path, WARP_CACHE_PATH=str(tmp_path / "a"), TMPDIR=str(tmp_path))
    assert error.startswith("The kernels of ") and error.endswith("to a folder that can be written.")
    assert [path.name for path in tmp_path.iterdir()] == ["a"] and not list((tmp_path / "a").rglob("*.o"))


def test_an_error_of_all_caches_has_fields(monkeypatch):
    def fail(_why):
        raise OSError(28, "No space left on device", "/tmp")

    monkeypatch.setattr(kernel_cache, "use_temporary_cache", fail)
    monkeypatch.setattr(kernel_cache, "has_temporary_cache", lambda: False)
    monkeypatch.setattr(kernel_cache, "_build_folder", lambda: fail(""))
    with pytest.raises(TerrainError) as caught:
        kernel_cache.ensure_writable()
    assert "No space left on device" in caught.value.what and caught.value.where == "/tmp"
    assert caught.value.fix.startswith("set WARP_CACHE_PATH or TMPDIR")
