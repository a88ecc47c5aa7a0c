# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: its files, output and failures."""

import json

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing import thinning
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from fields import reference_heights
from forked_programs import run_program
from store_exports import bytes_of, run


def test_a_frame_is_arrays_with_what_they_mean(export):
    code, printed, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "2")
    assert code == 0
    mesh = read_npz(folder / "terrain_0002.npz")
    info = mesh.pop("info")
    shapes = {name: (array.dtype.name, array.shape[1:]) for name, array in mesh.items()}
    assert shapes == {
        "positions": ("float32", (3,)),
        "origin": ("float64", ()),
        "triangles": ("int32", (3,)),
        "edges": ("int32", (2,)),
        "normals": ("float32", (3,)),
        "uv": ("float32", (2,)),
        "terrain_level": ("int32", ()),
        "tree": ("uint8", ()),
    }
    assert info["triangles"] == len(mesh["triangles"]) > 100
    assert len(mesh["positions"]) - len(mesh["edges"]) + len(mesh["triangles"]) == 1
    assert 0 < info["bound_px"] <= 2 == info["asked"]["error_px"]
    assert info["units"]["positions"] == "m"
    assert info["views"][0]["resolution"] == [640, 360]
    assert '"ms"' not in json.dumps(info)


def test_a_summary_line_for_each_frame(export):
    code, printed, folder = export("--frames", "1-3:2", "--format", "npz")
    lines = printed.out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["frame 1", "frame 3"]
    assert all(" triangles, bound " in line and " px, " in line and line.endswith(" ms in all") for line in lines)
    assert printed.err == ""
    summary = json.loads((folder / "frame_0003.json").read_text())
    assert summary["files"] == {"terrain_0003.npz": (folder / "terrain_0003.npz").stat().st_size}
    assert summary["terrains"][0]["ms"]["total"] > 0


def test_a_frame_does_not_depend_on_those_before(export):
    export("--frames", "1-4", "--format", "npz", out="all")
    export("--frames", "3", "--format", "npz", out="one")
    _, _, played = export("--frames", "1-4", "--format", "npz", out="all")
    _, _, alone = export("--frames", "3", "--format", "npz", out="one")
    assert bytes_of(alone)["terrain_0003.npz"] == bytes_of(played)["terrain_0003.npz"]


def test_resume_leaves_complete_frames(export):
    _, _, folder = export("--frames", "1-4", "--format", "npz")
    before = bytes_of(folder)
    (folder / "terrain_0002.npz").write_bytes(b"half")
    (folder / "frame_0003.json").unlink()
    kept = [(folder / f"terrain_000{frame}.npz").stat().st_mtime_ns for frame in (1, 4)]
    code, printed, _ = export("--frames", "1-4", "--format", "npz", "--resume")
    assert code == 0
    assert [line.endswith("complete before") for line in printed.out.splitlines()] == [True, False, False, True]
    assert bytes_of(folder) == before
    assert [(folder / f"terrain_000{frame}.npz").stat().st_mtime_ns for frame in (1, 4)] == kept


def test_resume_makes_frames_of_other_settings_again(export):
    export("--frames", "1", "--format", "npz", "--pixel-error", "4")
    _, printed, folder = export("--frames", "1", "--format", "npz", "--pixel-error", "1", "--resume")
    assert "complete before" not in printed.out
    assert read_npz(folder / "terrain_0001.npz")["info"]["asked"]["error_px"] == 1


def test_budget_and_meshlet(export):
    _, printed, folder = export("--frames", "4", "--format", "npz", "--budget", "3000", "--meshlet", "1")
    info = read_npz(folder / "terrain_0004.npz")["info"]
    assert info["triangles"] <= 3000 and info["triangles"] == 4 * info["leaves"]
    assert info["limited"] == "max_triangles" and info["relaxed"] > 1 and info["bound_px"] > 1
    assert sum(info["terms_px"].values()) == pytest.approx(info["bound_px"])
    assert info["terms_m"] is info["bound_m"] is info["bound_edge_px"] is info["bound_area_px"] is None
    [figures] = json.loads((folder / "frame_0004.json").read_text())["terrains"]
    assert {name: figures[name] for name in ("terms_px", "terms_m")} == {n: info[n] for n in ("terms_px", "terms_m")}
    assert "held back by the triangle limit" in printed.out


def test_a_smooth_surface_may_be_asked_for(export):
    _, _, flat = export("--frames", "2", "--format", "npz", "--pixel-error", "0.5", out="flat")
    code, _, smooth = export("--frames", "2", "--format", "npz", "--pixel-error", "0.5", "--interpolation", "bicubic")
    infos = [read_npz(folder / "terrain_0002.npz")["info"] for folder in (flat, smooth)]
    assert code == 0 and [info["interpolation"] for info in infos] == ["bilinear", "bicubic"]
    assert infos[1]["triangles"] > infos[0]["triangles"] and infos[1]["height_field"] != infos[0]["height_field"]


def test_a_detail_may_be_asked_for(export, store, tmp_path):
    asked = Detail(2.0, 60.0)
    code, _, folder = export("--frames", "2", "--format", "npz", "--pixel-error", "2", "--detail", "2,60")
    baked = tmp_path / "hills.npz"
    assert code == 0 == run("bake", "--store", store, "--max-error", "1", "--detail", "2,60", "--out", baked)
    field = with_detail(open_store(store), asked)
    for mesh in map(read_npz, (folder / "terrain_0002.npz", baked)):
        assert mesh["info"]["height_field"].endswith(asked.key)
        points = mesh["positions"].astype(np.float64)
        assert np.abs(points[:, 2] - reference_heights(field, points[:, :2])).max() < 1e-4
    middles = points[mesh["triangles"]].mean(1)
    assert np.abs(middles[:, 2] - reference_heights(field, middles[:, :2])).max() <= mesh["info"]["bound_m"] <= 1.0


def test_bake_holds_its_error(store, tmp_path, capsys):
    assert run("bake", "--store", store, "--max-error", "0.5", "--out", tmp_path / "hills.npz") == 0
    info = read_npz(tmp_path / "hills.npz")["info"]
    assert 0 < info["bound_m"] <= 0.5 and info["bound_px"] is None and info["views"] == []
    assert info["terms_px"] is None and info["terms_m"].keys() == {"geometric", "precision", "source"}
    assert capsys.readouterr().out.startswith(f"hills.npz: {info['triangles']:,} triangles, bound 0.")


def test_a_bake_of_a_smooth_surface_cannot_be_fitted(store, tmp_path, capsys):
    bake = ["bake", "--store", store, "--max-error", "2", "--interpolation", "bicubic", "--out"]
    assert run(*bake, tmp_path / "smooth.npz") == 0
    assert read_npz(tmp_path / "smooth.npz")["info"]["interpolation"] == "bicubic"
    assert run(*bake, tmp_path / "fitted.npz", "--fit") == 1
    assert "bilinear" in capsys.readouterr().err and not (tmp_path / "fitted.npz").exists()


def test_a_fitted_bake_holds_its_error_with_fewer_triangles(store, tmp_path, capsys):
    bake = ["bake", "--store", store, "--max-error", "5", "--out"]
    assert run(*bake, tmp_path / "plain.npz") == 0
    assert run(*bake, tmp_path / "fitted.npz", "--fit") == 0
    plain, fitted = (read_npz(tmp_path / f"{name}.npz") for name in ("plain", "fitted"))
    info = fitted["info"]
    assert info["fitted"] is True and "fitted" not in plain["info"]
    assert 2.5 < info["measured_max_m"] <= info["bound_m"] <= 5 == info["asked"]["error_m"]
    assert info["triangles"] == len(fitted["triangles"]) <= 0.85 * len(plain["triangles"])
    assert f"fitted.npz: {info['triangles']:,} triangles, bound " in capsys.readouterr().out
    first = (tmp_path / "fitted.npz").read_bytes()
    assert run(*bake, tmp_path / "again.npz", "--fit") == 0
    assert (tmp_path / "again.npz").read_bytes() == first


def test_a_quick_import_says_what_it_lacks(tmp_path, flight, capsys, monkeypatch):
    monkeypatch.setattr(thinning, "QUICK_SAMPLES", 500)
    store = tmp_path / "store"
    assert run("import", "island", "--size", "129", "--store", store, "--quick") == 0
    assert "loaded: to 512 m of 64 m" in capsys.readouterr().out
    assert run("info", store) == 0
    printed = capsys.readouterr().out
    assert "loaded: to 512 m of 64 m\n" in printed and "complete: False\n" in printed
    assert "bounds_against: the surface as loaded so far, to 512 m of 64 m\n" in printed
    export = ["export", "--store", store, "--path", flight, "--frames", "1", "--out", tmp_path / "out"]
    assert run(*export, "--format", "npz") == 0
    assert "terrain is loaded to 512 m of 64 m" in capsys.readouterr().out
    assert run("import", "island", "--size", "129", "--store", store) == 0
    assert run("info", store) == 0
    assert "loaded" not in capsys.readouterr().out


def test_import_info_and_export_by_words(tmp_path, flight, capsys):
    heights = np.fromfunction(lambda y, x: 30 * np.sin(x / 9) + y, (60, 90), dtype=np.float32)
    np.save(tmp_path / "hills.npy", heights)
    store = tmp_path / "hills.store"
    source = tmp_path / "hills.npy"
    assert run("import", source, "--store", store, "--extent", "900x600") == 0
    assert f"{store} is ready" in capsys.readouterr().out
    assert run("info", store) == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    assert run("info", source) == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    heights.astype("<f4").tofile(tmp_path / "hills.raw")
    assert run("info", tmp_path / "hills.raw") == 1
    assert "--raw-size" in capsys.readouterr().err
    assert run("info", tmp_path / "hills.raw", "--raw-size", "90x60", "--raw-type", "float32") == 0
    assert "raster: 90, 60" in capsys.readouterr().out.splitlines()
    assert run("bake", "--store", store, "--max-error", "1", "--out", tmp_path / "hills.npz") == 0
    capsys.readouterr()
    assert run("info", tmp_path / "hills.npz") == 0
    assert "bound_m: " in capsys.readouterr().out


def test_npz_needs_no_bpy(store, flight, tmp_path):
    """In a Python where bpy cannot be imported, an export of .npz works and one of .ply names the missing package."""
    out = tmp_path / "out"
    script = f"""
import sys
sys.modules["bpy"] = None
from adaptive_terrain.operators.cli.command_line import main
common = ["export", "--store", {store!r}, "--path", {str(flight)!r}, "--frames", "1", "--out", {str(out)!r}]
assert main([*common, "--format", "npz"]) == 0
sys.exit(main([*common, "--format", "ply"]))
"""
    result = run_program(script)
    assert result.returncode == 1, result.stderr
    assert "This format needs Blender's Python module" in result.stderr.splitlines()[-1]
    assert (out / "terrain_0001.npz").exists()


def test_a_file_where_a_folder_is_expected(export, tmp_path, capsys):
    (tmp_path / "out").write_text("something")
    code, printed, _ = export("--frames", "1", "--format", "npz")
    assert code == 1 and "expected a folder" in printed.err and len(printed.err.splitlines()) == 1
    code, printed, _ = export("--frames", "1", "--format", "npz", out="out/below")
    assert code == 1 and "expected a folder" in printed.err
    pytest.importorskip("bpy")
    assert run("demo", "--out", tmp_path / "out") == 1
    assert "expected a folder" in capsys.readouterr().err


def test_a_fit_that_saves_nothing_says_so(tmp_path, capsys):
    heights = np.random.default_rng(0).uniform(0.0, 100.0, (20, 31)).astype(np.float32)
    np.save(tmp_path / "noise.npy", heights)
    store = tmp_path / "noise.store"
    assert run("import", tmp_path / "noise.npy", "--store", store) == 0
    bake = ["bake", "--store", store, "--max-error", "0.5", "--budget", "2", "--fit"]
    assert run(*bake, "--out", tmp_path / "noise.npz") == 0
    assert "the fit saved no triangles" in capsys.readouterr().out
