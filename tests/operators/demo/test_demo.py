# SPDX-License-Identifier: GPL-3.0-or-later
"""A small demo: every file exists, pictures are not empty, and the page names its contents."""

import contextlib
import io
import re

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("bpy")

from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.operators.cli import command_line
from adaptive_terrain.operators.demo import demo
from adaptive_terrain.operators.demo import scene as demo_scene
from browser import needs_chromium, opened


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the folder of a demo of a coarse island with small pictures of few samples."""
    out = tmp_path_factory.mktemp("demo") / "demo"
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.setattr(demo, "SIZE", 129)
        patch.setattr(demo, "RESOLUTION", (96, 54))
        patch.setattr(demo, "PLAN_RESOLUTION", (64, 64))
        patch.setattr(demo_scene, "SAMPLES", 1)
        patch.setattr(demo_scene, "MAPS_MB", 0.5)
        assert command_line.main(["demo", "--out", str(out)]) == 0
    assert printed.getvalue().splitlines()[-1].startswith(f"{out / 'index.html'} shows it")
    return out


def test_demo_makes_its_page_and_all_that_it_shows(made):
    page = (made / "index.html").read_text(encoding="utf-8")
    shown = re.findall(r'src="(?!data:)([^"]+)"', page)
    assert shown == ["frame_01.png", "frame_12.png", "frame_24.png", "levels.png", "plan.png"]
    assert page.count('src="data:image/png') == len(demo.CROPS_PX)
    for name in shown:
        assert np.asarray(Image.open(made / name).convert("L")).std() > 5, name
    elsewhere = set(re.findall(r"https?://[^\"' ]+", page)) - {"http://www.w3.org/2000/svg"}
    assert not elsewhere, "the page needs nothing from elsewhere"
    bounds = []
    for frame in range(1, 25):
        info = read_npz(made / "meshes" / f"terrain_{frame:04d}.npz")["info"]
        bounds.append(info["bound_px"])
        assert f"{info['triangles']:,}" in page
    assert 0 < max(bounds) <= 1.0
    assert (made / "island.blend").stat().st_size > 10_000


def test_the_page_lists_read_and_skipped_attributes(made):
    page = (made / "index.html").read_text(encoding="utf-8")
    rows = dict(re.findall(r"<tr><td>(snow)</td><td>([^<]*)</td>", page))
    assert rows == {"snow": "material Island Material, node Attribute"}
    assert re.search(r"they are not computed: [a-z_\d, ]*\bsplat_3\b[a-z_, ]*\bsun\b", page)
    assert not re.search(r"<tr><td>(color|sky|detail_normal)</td>", page), "they are maps"


@needs_chromium
def test_a_browser_shows_the_page_with_every_picture(made, tmp_path):
    seen = opened(made / "index.html", tmp_path)
    assert not seen.errors and seen.wide <= 0
    assert len(seen.pictures) == 5 + len(demo.CROPS_PX) + 1 and all(there for _, there in seen.pictures)
    assert seen.text.startswith("An island, seen from the air") and "Frame by frame" in seen.text
    (made / "frame_12.png").rename(made / "elsewhere.png")
    lacking = opened(made / "index.html", tmp_path)
    assert lacking.errors and [there for _, there in lacking.pictures].count(False) == 1
    (made / "elsewhere.png").rename(made / "frame_12.png")
