# SPDX-License-Identifier: GPL-3.0-or-later
"""Requirements of `make`: the lock covers all dependencies, and a missing library is named."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def check_system():
    spec = importlib.util.spec_from_file_location("check_system", ROOT / "tools" / "check_system.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_lock_has_every_dependency_for_both_pythons():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *(name for extra in project["optional-dependencies"].values() for name in extra)]
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    for python in ("3.11", "3.13"):
        locked = {
            line.split("==")[0].lower()
            for line in lock
            if not line.startswith("#") and (";" not in line or f'"{python}"' in line)
        }
        names = {re.match(r"[A-Za-z0-9_.-]+", requirement)[0].lower() for requirement in asked}
        assert names <= locked, python
    assert not re.search(r"https?:|--", "\n".join(lock)), "the lock names no host"


def test_a_missing_library_is_named_by_its_package(check_system, monkeypatch, capsys):
    loaded = check_system.ctypes.CDLL

    def load(name):
        if name in ("libXrender.so.1", "libSM.so.6"):
            raise OSError(f"{name}: cannot open shared object file")
        return loaded(name)

    monkeypatch.setattr(check_system.ctypes, "CDLL", load)
    monkeypatch.setattr(check_system.sys, "argv", ["check_system.py"])
    monkeypatch.setattr(check_system.sys, "platform", "linux")
    assert check_system.main() == 1
    assert "apt-get install libgl1-mesa-dri libsm6 libxrender1\n" in capsys.readouterr().err


def test_another_python_is_refused(check_system, monkeypatch, capsys):
    monkeypatch.setattr(check_system.sys, "argv", ["check_system.py"])
    monkeypatch.setattr(check_system.sys, "version_info", (3, 12, 1))
    assert check_system.main() == 1
    assert "Python 3.12.1 was found" in capsys.readouterr().err
