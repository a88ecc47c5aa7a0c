# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of .blend files that were saved on another system."""

import os

import bpy
import pytest
from adaptive_terrain.operators.bridge.scene_paths import absolute_path

POSIX = pytest.mark.skipif(os.sep == "\\", reason="a backslash is a separator here")


@pytest.fixture
def folder(tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return tmp_path


@POSIX
@pytest.mark.parametrize(
    "text", [r"//terrain\store", "//terrain/store", r"//terrain\sub\..\store", r"//.\terrain\store"]
)
def test_backslashes_separate_folders(folder, text):
    (folder / "terrain" / "sub").mkdir(parents=True)
    (folder / "terrain" / "store").mkdir()
    assert os.path.samefile(absolute_path(text), folder / "terrain" / "store")


@POSIX
def test_an_existing_name_with_a_backslash_is_kept(folder):
    (folder / r"a\b").mkdir()
    assert absolute_path(r"//a\b") == str(folder / r"a\b")


@POSIX
def test_a_path_with_a_drive_letter_stays(folder):
    assert absolute_path(r"C:\terrain\store") == r"C:\terrain\store"


@POSIX
def test_a_missing_folder_is_made_below_the_project(folder):
    assert absolute_path(r"//new\store") == str(folder / "new" / "store")
