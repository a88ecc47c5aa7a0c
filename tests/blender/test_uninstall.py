# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores survive an uninstall in the real program, including those of version 0.2.0 in the deleted folder."""

import os
import shutil
from pathlib import Path

import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from real_program import EXTENSION, Program


@pytest.fixture
def fresh_program(program, tmp_path):
    """Copy the installed extension and the settings to a separate user folder; share compiled kernels and wheels."""
    fresh = Program(program.wrapper, tmp_path / "user")
    fresh.kernels = program.kernels
    wheels = "extensions/.local"
    for folder in ("config", "extensions/user_default"):
        shutil.copytree(program.user / folder, fresh.user / folder)
    shutil.copytree(program.user / wheels, fresh.user / wheels, copy_function=os.link)
    return fresh


def test_an_uninstall_deletes_no_store(fresh_program, tmp_path):
    before = fresh_program.script("store_folders.py", "old", tmp_path)
    user = fresh_program.user / "extensions" / ".user" / "user_default" / "adaptive_terrain"
    assert Path(before["store"]).is_relative_to(user / "stores")
    after = fresh_program.script("store_folders.py", "new", tmp_path)
    data = fresh_program.user / "datafiles" / "adaptive_terrain" / "stores"
    assert Path(after["moved"]["store"]) == data / Path(before["store"]).name and after["moved"]["key"] == before["key"]
    assert after["shaped_again"] == 0 and not (user / "stores").exists()
    assert len(after["notices"]) == 2 and all(str(data) in notice for notice in after["notices"])
    assert Path(after["unsaved"]["store"]).parent == data and after["saved"] == after["unsaved"], (
        "a save copies nothing"
    )
    assert after["baked"]["path"] == "//terrain/old_Terrain_island_baked"
    assert after["beside"]["path"] == "//terrain/new_Terrain_island"
    fresh_program.run("--command", "extension", "remove", EXTENSION.removeprefix("bl_ext."))
    assert not user.exists() and not (fresh_program.user / "extensions" / "user_default" / "adaptive_terrain").exists()
    for found in (after["moved"], after["baked"], after["unsaved"], after["beside"]):
        assert open_store(found["store"])
