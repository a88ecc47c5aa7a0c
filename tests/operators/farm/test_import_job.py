# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that import a large height map on a farm: their template, and a run by openjd-cli."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing import import_work
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.cli import command_line, parser
from adaptive_terrain.operators.farm import import_job
from openjd.model import decode_job_template
from rasters import hills
from store_exports import run
from tiled_stores import assert_built, assert_same, tiled  # noqa: F401
from worker_program import worker_program

# Stands for Blender: imports in its own process, with small tiles.
WORKER = """
from adaptive_terrain.cbt_terrain.importing import build_store, import_process, import_work
from adaptive_terrain.operators.cli import command_line
import_work.TILE_BITS = 5

def import_source(settings, store, on_progress, _on_preview, part):
    return build_store.run_import(settings, store, on_progress, part=part)

import_process.import_source = import_source

def work(arguments):
    assert arguments[:2] == ["--command", "adaptive_terrain"]
    return command_line.main(arguments[2:])
"""


def test_openjd_runs_an_import_from_begin_to_publish(tmp_path, tiled):  # noqa: F811
    heights = hills(120, 90)
    heights[20:40, 30:70] = np.nan
    np.save(tmp_path / "a.npy", heights)
    settings = ImportSettings(str(tmp_path / "a.npy"), extent=(1190.0, 890.0), holes=True)
    tiled(None)
    run_import(settings, tmp_path / "whole")
    tiled(5)
    lines = import_job.write_import_job(settings, (120, 90), tmp_path / "store", tmp_path / "job", 6)
    assert lines[0].endswith("is a job of 12 tiles, 6 a task")
    command = lines[1].removeprefix("to run it on this machine: ").replace("openjd run", f"{openjd()} run")
    with worker_program(tmp_path / "blender", WORKER) as worker:
        done = subprocess.run(f"{command} --job-param Blender={worker}", shell=True, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("done: 6") == 4
    assert_same(tmp_path / "store", tmp_path / "whole")
    assert len(list((tmp_path / "store").glob("data-*"))) == 1


def test_a_task_has_twelve_tiles_by_default(tmp_path, capsys, monkeypatch):
    np.save(tmp_path / "a.npy", hills(120, 90))
    monkeypatch.setattr(import_work, "TILE_BITS", 5)
    job = "import", tmp_path / "a.npy", "--store", tmp_path / "store", "--job", tmp_path / "job"
    assert run(*job) == 0 and "a job of 12 tiles, 12 a task" in capsys.readouterr().out
    assert run(*job, "--chunk", "3") == 0 and "a job of 12 tiles, 3 a task" in capsys.readouterr().out


def openjd():
    return Path(sys.executable).with_name("openjd")


def test_a_job_repeats_all_options(tmp_path):
    settings = ImportSettings(
        str(tmp_path / "a.raw"),
        extent=(10.5, 20.0),
        raw_little_endian=False,
        raw_dtype="int16",
        no_data=-1.0,
        holes=True,
        height_scale=0.5,
    )
    arguments = import_job.import_arguments(settings)
    parsed = parser.build_parser().parse_args(
        command_line._with_negatives_joined(["import", "--store", "s", *arguments])
    )
    from adaptive_terrain.operators.cli.import_verbs import _import_settings

    assert _import_settings(parsed, parsed.sources) == settings
    mosaic = ImportSettings(
        settings.source,
        more_sources=(settings.source + "b",),
        blend=False,
        priority="resolution",
        step=2.5,
        project="utm",
    )
    parsed = parser.build_parser().parse_args(["import", "--store", "s", *import_job.import_arguments(mosaic)])
    assert _import_settings(parsed, parsed.sources) == mosaic
    template = import_job.import_template(settings)
    import yaml

    decode_job_template(template=yaml.safe_load(template), supported_extensions=["TASK_CHUNKING"])


def test_strange_names_have_no_job(tmp_path):
    with pytest.raises(TerrainError, match="rename it"):
        import_job.import_template(ImportSettings(str(tmp_path / "{{a}}.npy")))
    assert not (tmp_path / "job").exists()


def test_a_job_is_not_written_into_its_store(tmp_path, capsys):
    np.save(tmp_path / "a.npy", hills(9, 9))
    for folder in (tmp_path / "store", tmp_path / "store" / "job"):
        assert run("import", tmp_path / "a.npy", "--store", tmp_path / "store", "--job", folder) == 1
        assert "choose another folder (--job)" in capsys.readouterr().err and not (tmp_path / "store").exists()


def test_a_small_raster_is_imported_in_parts(tmp_path, capsys):
    heights = hills(9, 1)
    np.save(tmp_path / "a.npy", heights)
    where = tmp_path / "a.npy", "--store", tmp_path / "store"
    for part in (["begin"], ["read", "--tiles", "0"], ["fill"], ["measure", "--tiles", "0"]):
        assert run("import", *where, "--only", *part) == 0
        assert "tiles: 1" in capsys.readouterr().out and not (tmp_path / "store" / "store.json").exists()
    assert run("import", *where) == 0
    assert_built(open_store(tmp_path / "store"), np.repeat(heights, 2, 0))
    assert len(list((tmp_path / "store").glob("data-*"))) == 1
    assert run("import", *where, "--job", tmp_path / "job") == 0
    assert "a job of 1 tiles, 12 a task" in capsys.readouterr().out


def test_contradicting_options_of_parts_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", hills(9, 9))
    where = tmp_path / "a.npy", "--store", tmp_path / "store"
    assert run("import", *where, "--only", "read") == run("import", *where, "--tiles", "0-3") == 2
    assert run("import", *where, "--only", "begin", "--tiles", "0-3") == run("import", *where, "--chunk", "3") == 2
    assert run("import", *where, "--job", tmp_path / "job", "--quick") == 2
    assert run("import", *where, "--only", "begin", "--quick") == 2
    assert not (tmp_path / "store").exists() and not (tmp_path / "job").exists()
