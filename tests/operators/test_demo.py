# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo, small: every file is there, pictures show something, the page names what it shows."""

import re

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("bpy")

from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.cli import command_line
from adaptive_terrain.operators.demo import demo
from adaptive_terrain.operators.demo import scene as demo_scene


@pytest.fixture
def small(monkeypatch):
    """A coarse island and small pictures of few samples."""
    monkeypatch.setattr(demo, "SIZE", 257)
    monkeypatch.setattr(demo, "RESOLUTION", (160, 90))
    monkeypatch.setattr(demo, "PLAN_RESOLUTION", (100, 100))
    monkeypatch.setattr(demo_scene, "SAMPLES", 1)


def test_demo_makes_its_page_and_all_that_it_shows(small, tmp_path, capsys):
    out = tmp_path / "demo"
    assert command_line.main(["demo", "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{out / 'index.html'} shows it")
    page = (out / "index.html").read_text(encoding="utf-8")
    shown = re.findall(r'src="([^"]+)"', page)
    assert shown == ["frame_01.png", "frame_12.png", "frame_24.png", "levels.png", "plan.png"]
    for name in shown:
        assert np.asarray(Image.open(out / name).convert("L")).std() > 5, name
    assert "http" not in page, "the page needs nothing from elsewhere"
    bounds = []
    for frame in range(1, 25):
        info = read_npz(out / "meshes" / f"terrain_{frame:04d}.npz")["info"]
        bounds.append(info["bound_px"])
        assert f"{info['triangles']:,}" in page
    assert 0 < max(bounds) <= 1.0
    assert (out / "island.blend").stat().st_size > 10_000
