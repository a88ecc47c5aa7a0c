# SPDX-License-Identifier: GPL-3.0-or-later
"""`export --anchor`: positions about a point near the camera path, whose coordinates are the file's origin."""

import json

import numpy as np
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.heightfield import anchored
from adaptive_terrain.cbt_terrain.field.store import Draft, open_store
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from adaptive_terrain.cbt_terrain.terrain import Terrain
from store_exports import run

STEP, X = 123.4, 400_000.0
FLIGHT = {"fov": 50, "clip": [1, 1e6], "keyframes": [{"frame": 3, "eye": [X, -300, 900], "target": [X, 0, 0]}]}


def test_positions_are_about_a_point_near_the_path(tmp_path):
    draft = Draft(tmp_path / "country")
    samples = draft.allocate("samples", (5, 8193), np.float32)
    samples[:] = 100.0 * np.sin(np.arange(8193) / 3)
    field = build(samples, STEP, STEP, missing=0, allocate=draft.allocate)
    place = (0.5, 0.0, 9.8e5, 0.0, 2.0, 2e5)  # units of 2 m and of 0.5 m
    draft.publish(field.with_raster(crs="EPSG:2263", origin=np.array([9.8e5, 2e5, 0.0]), place=place), "country", {})
    (tmp_path / "flight.json").write_text(json.dumps(FLIGHT))
    found = []
    for name, more in (("plain", []), ("near", ["--anchor"])):
        arguments = ["--store", tmp_path / "country", "--path", tmp_path / "flight.json", "--frames", "3", *more]
        out = tmp_path / name
        assert run("export", *arguments, "--format", "npz", "--out", out) == 0
        found.append(read_npz(next(out.rglob("*.npz"))))
    (plain, near), anchor = found, [391 * 1024.0, 0.0]
    assert plain["origin"].tolist() == [9.8e5, 2e5, 0.0] and near["origin"].tolist() == [
        9.8e5 + anchor[0] / 2,
        2e5,
        0.0,
    ]
    assert near["info"]["anchor"] == anchor and "anchor" not in plain["info"]
    there = near["positions"].astype(np.float64) + [*anchor, 0.0]
    assert np.array_equal(near["triangles"], plain["triangles"]) and np.abs(there - plain["positions"]).max() < 0.05
    assert np.abs(near["info"]["placement"] - np.array(plain["info"]["placement"]))[0, 3] == anchor[0]
    again = Terrain(anchored(open_store(tmp_path / "country"), *anchor)).restore(
        near["tree"].tobytes(), **near["info"]["tree"]
    )
    assert again.surface.positions.tobytes() == near["positions"].tobytes()
