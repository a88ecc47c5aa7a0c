# SPDX-License-Identifier: GPL-3.0-or-later
"""A job bundle of Open Job Description, as `deadline bundle submit` and `openjd run` take it, and a job type for
Flamenco. JSON is YAML, so what is made of values is written as JSON; what is written by hand are files beside this."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ..output.exporting import write_files

HERE = Path(__file__).parent
TEMPLATE, VALUES, ASSETS = "template.yaml", "parameter_values.yaml", "asset_references.yaml"
GUARD, FLAMENCO = "guard.py", "adaptive_terrain_render.js"
NO_YAML = "[\x7f-\x9f\u2028\u2029\ufeff]"  # what JSON may hold as it is, and YAML drops or refuses
MOST_NAME, MOST_TEXT = 64, 1024  # characters of the job's name, and of any other value


@dataclass(frozen=True)
class Job:
    """What a farm is asked for: all paths absolute. `formats`: of the meshes; none for pictures. `zip_path`: of the
    extension, None where workers have it. `files`, `folders`: that a worker reads; `made`: folders it writes before
    the frames, which go to `out`."""

    name: str
    blend: Path
    frames: Sequence[int]
    chunk: int
    formats: Sequence[str]
    out: Path
    version: str
    zip_path: Path | None
    files: Sequence[Path]
    folders: Sequence[Path]
    made: Sequence[Path]


def write_bundle(job: Job, folder: Path) -> None:
    """Write the bundle's files; raises TerrainError where that cannot be."""
    if len(range_text(job.frames)) > MOST_TEXT:
        raise TerrainError("The frames are in too many pieces for one job; expected ranges: make a job of each part.")
    guard = _text("guard.py").replace('VERSION = ""', f'VERSION = "{job.version}"')
    flamenco = _text("flamenco.js").replace('"@GUARD@"', json.dumps(guard))
    files = {TEMPLATE: template(job, guard), VALUES: _values(job), ASSETS: _assets(job)}
    try:
        write_files(folder, files | {GUARD: guard, FLAMENCO: flamenco})
    except UnicodeEncodeError as reason:
        path = shown(reason.object[max(0, reason.start - 60) : reason.end])
        raise TerrainError(f"A path of the job is not UTF-8 ({path}); rename the file or its folder.") from None


def template(job: Job, guard: str) -> str:
    """The job's template: its beginning, and the steps of meshes or of pictures."""
    steps = _text("meshes.yaml" if job.formats else "render.yaml")
    indent = " " * 8
    return _text("job.yaml").replace("@GUARD@", guard.strip().replace("\n", f"\n{indent}")) + steps


def range_text(frames: Sequence[int]) -> str:
    """Frames in rising order as Open Job Description writes a range: `1-24,30-60:2`, none twice."""
    rest, parts, at = sorted(set(frames)), [], 0
    while at < len(rest):
        step = rest[at + 1] - rest[at] if at + 1 < len(rest) else 1
        count = 1
        while at + count < len(rest) and rest[at + count] - rest[at + count - 1] == step:
            count += 1
        if count == 2 and step > 1:  # two alone are no row
            count = 1
        first, last = rest[at], rest[at + count - 1]
        parts.append(f"{first}" if count == 1 else f"{first}-{last}" + (f":{step}" if step > 1 else ""))
        at += count
    return ",".join(parts)


def _values(job: Job) -> str:
    values = {
        "JobName": shown(job.name)[:MOST_NAME],  # without line breaks, which a name must not have
        "BlenderFile": str(job.blend),
        "Frames": range_text(job.frames),
        "ChunkSize": job.chunk,
        "Format": ",".join(job.formats),
        "OutputDir": str(job.out),
        "ExtensionZip": "" if job.zip_path is None else str(job.zip_path),
    }
    return _json({"parameterValues": [{"name": name, "value": value} for name, value in values.items()]})


def _assets(job: Job) -> str:
    """What is brought to a worker and back. Nobody finds the stores by looking into the .blend file."""
    inputs = {"filenames": _names([job.blend, *job.files]), "directories": _names(job.folders)}
    outputs = {"directories": _names([job.out, *job.made])}
    return _json({"assetReferences": {"inputs": inputs, "outputs": outputs, "referencedPaths": []}})


def _names(paths: Sequence[Path]) -> list[str]:
    return sorted({str(path) for path in paths})


def _json(content: dict) -> str:
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    return re.sub(NO_YAML, lambda found: f"\\u{ord(found[0]):04x}", text)


def _text(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")
