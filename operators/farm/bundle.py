# SPDX-License-Identifier: GPL-3.0-or-later
"""A job bundle of Open Job Description for `deadline bundle submit` and `openjd run`, and a job type for Flamenco.

Generated parts are written as JSON, which is YAML. The other parts are files in this folder.
"""

import json
import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ..export.exporting import write_files
from ..export.formats import range_text

HERE = Path(__file__).parent
TEMPLATE, VALUES, ASSETS = "template.yaml", "parameter_values.yaml", "asset_references.yaml"
OPENJD_VALUES = "openjd_parameters.json"  # the same values as `openjd run` reads them
GUARD, FLAMENCO, CONTAINER = "guard.py", "adaptive_terrain_render.js", "Containerfile"
# Operating system and processor in Open Job Description, by Blender's name of the platform.
PLATFORMS = {
    "linux-x64": ("linux", "x86_64"),
    "linux-arm64": ("linux", "arm64"),
    "windows-x64": ("windows", "x86_64"),
    "windows-arm64": ("windows", "arm64"),
    "macos-x64": ("macos", "x86_64"),
    "macos-arm64": ("macos", "arm64"),
}
NO_YAML = "[\x7f-\x9f\u2028\u2029\ufeff]"  # characters that JSON allows and YAML drops or refuses
STORES_PARAMETER = """- name: StoresDir
  type: PATH
  objectType: DIRECTORY
  dataFlow: INOUT
  description: Stores of this job, with the tiles that its frames see, and records of imports that tasks share."""
MAX_SHARES, SHARE_TILES = 16, 8  # of tasks that share an import: one for SHARE_TILES tiles, MAX_SHARES at most
MAX_NAME, MAX_TEXT = 64, 1024  # characters of the job's name, and of any other value


@dataclass(frozen=True)
class FarmJob:
    """A job for a farm. All paths are absolute.

    Attributes:
        blend: the scene's file.
        frames: their numbers.
        chunk: frames per task.
        formats: of meshes; empty for pictures.
        out: folder of the frames.
        version: of the extension.
        zip_path: the extension's zip, None if workers have the extension.
        files, folders: inputs of a worker.
        output_folders: folders that a worker writes before the frames.
        platforms: platforms of the zip, by Blender's names.
        min_memory_gib: required memory of a worker, 0 for any.
        stores: folder of the job's stores and of records of shared imports; None if tasks share no import.
        max_tiles: the largest number of tiles of a terrain that tasks share.
        has_view: whether tasks load the tiles in view of incomplete stores.
    """

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
    output_folders: Sequence[Path]
    platforms: Sequence[str] = ()
    min_memory_gib: float = 0.0
    stores: Path | None = None
    max_tiles: int = 0
    has_view: bool = False


def write_bundle(job: FarmJob, folder: Path) -> None:
    """Write the files of a job into `folder`, for Open Job Description and Flamenco.

    Raises TerrainError for too many ranges of frames, a path that is not UTF-8, and files that cannot be written.
    """
    if len(range_text(job.frames)) > MAX_TEXT:
        raise TerrainError(
            "The frames have too many gaps for one job", expected="ranges", fix="make a job of each part"
        )
    guard = read_template("guard.py").replace('VERSION = ""', f'VERSION = "{job.version}"')
    flamenco = read_template("flamenco.js").replace('"@GUARD@"', json.dumps(guard))
    flamenco = flamenco.replace("IMPORT_TASKS = 0", f"IMPORT_TASKS = {_num_shares(job)}")
    values = _parameter_values(job)
    value_list = {"parameterValues": [{"name": name, "value": value} for name, value in values.items()]}
    files = {
        TEMPLATE: job_template(job, guard),
        VALUES: to_yaml_json(value_list),
        OPENJD_VALUES: to_yaml_json(values),  # the form that `openjd run` reads
        ASSETS: _asset_references(job),
    }
    try:
        write_files(folder, files | {GUARD: guard, FLAMENCO: flamenco, CONTAINER: read_template(CONTAINER)})
    except UnicodeEncodeError as reason:
        path = shown(reason.object[max(0, reason.start - 60) : reason.end])  # the end of the path up to that character
        raise TerrainError("A path of the job is not UTF-8", path, fix="rename the file or its folder") from None


def job_template(job: FarmJob, guard: str) -> str:
    """Return the template of a job as YAML. `guard`: source of guard.py, which runs before the frames."""
    steps = read_template("meshes.yaml" if job.formats else "render.yaml")
    indent = " " * 8  # of the embedded file in job.yaml
    text = read_template("job.yaml") + steps
    is_shared = job.stores is not None
    after_shares = "  dependencies: [{dependsOn: Measure}]\n"  # the last of the shared steps
    parts = {
        "@SHARED_STEPS@\n": _shared_steps(job) if is_shared else "",
        "  @AFTER_SHARES@\n": after_shares if is_shared else "",
        "@STORES_PARAMETER@\n": f"{STORES_PARAMETER}\n" if is_shared else "",
        '"@JOB_STORES@", ': '--job-stores, "{{Param.StoresDir}}", ' if is_shared else "",
        "  @HOST_REQUIREMENTS@\n": host_requirements(job),
        "@GUARD@": guard.strip().replace("\n", f"\n{indent}"),
    }
    for mark, part in parts.items():
        text = text.replace(mark, part)
    return text


def _shared_steps(job: FarmJob) -> str:
    """Return the steps of imports that tasks share, as YAML.

    With incomplete stores, the first steps load the tiles in view; otherwise the first one only begins imports. The
    other steps, which depend on the last of these, import all samples where that has begun.
    """
    first, begin = ("view_steps.yaml", "Load") if job.has_view else ("begin_step.yaml", "Begin")
    text = read_template(first) + read_template("shared_steps.yaml").replace("@BEGIN@", begin)
    return text.replace("@SHARES@", str(_num_shares(job)))


def _num_shares(job: FarmJob) -> int:
    """Return the number of tasks that share a step of an import; 0 for a job without such imports."""
    return min(MAX_SHARES, -(-job.max_tiles // SHARE_TILES))


def host_requirements(job: FarmJob) -> str:
    """Return the line of YAML that limits the workers of each step, "" for any worker.

    A zip has libraries of its platforms only, so a worker of another platform cannot install it. Platforms that
    PLATFORMS lacks are left out; operating systems and processors are limited separately.
    """
    known = [PLATFORMS[name] for name in job.platforms if name in PLATFORMS]
    names = ("attr.worker.os.family", "attr.worker.cpu.arch")
    requirements = {}
    if known:
        values = [sorted(set(column)) for column in zip(*known, strict=True)]  # operating systems, processors
        requirements["attributes"] = [{"name": n, "anyOf": v} for n, v in zip(names, values, strict=True)]
    if job.min_memory_gib:
        memory_mib = math.ceil(job.min_memory_gib * 1024)
        requirements["amounts"] = [{"name": "amount.worker.memory", "min": memory_mib}]
    return f"  hostRequirements: {json.dumps(requirements)}\n" if requirements else ""


def openjd_command(folder: Path) -> str:
    """Return the shell command that runs the whole job in `folder` on this machine."""
    values = shlex.quote(f"file://{folder / OPENJD_VALUES}")
    return f"openjd run {shlex.quote(str(folder / TEMPLATE))} --step Verify --run-dependencies --job-param {values}"


def _parameter_values(job: FarmJob) -> dict[str, str]:
    """Return the values of the template's parameters by their names."""
    return {
        "JobName": shown(job.name)[:MAX_NAME],  # a name must not have line breaks
        "BlenderFile": str(job.blend),
        "Frames": range_text(job.frames),
        "ChunkSize": str(job.chunk),
        "Format": ",".join(job.formats),
        "OutputDir": str(job.out),
        "ExtensionZip": "" if job.zip_path is None else str(job.zip_path),
        **({} if job.stores is None else {"StoresDir": str(job.stores)}),
    }


def _asset_references(job: FarmJob) -> str:
    """Return JSON that lists the files to copy to a worker and back; farms cannot find stores in a .blend file."""
    inputs = {"filenames": _path_names([job.blend, *job.files]), "directories": _path_names(job.folders)}
    outputs = {"directories": _path_names([job.out, *job.output_folders])}
    return to_yaml_json({"assetReferences": {"inputs": inputs, "outputs": outputs, "referencedPaths": []}})


def _path_names(paths: Sequence[Path]) -> list[str]:
    """Return paths as sorted texts, each once."""
    return sorted({str(path) for path in paths})


def to_yaml_json(content: dict, indent: int | None = 1) -> str:
    """Return JSON that is valid YAML, too: characters that YAML refuses are escaped."""
    text = json.dumps(content, indent=indent, ensure_ascii=False) + "\n"
    return re.sub(NO_YAML, lambda found: f"\\u{ord(found[0]):04x}", text)


def read_template(name: str) -> str:
    """Return the text of a file in this folder."""
    return (HERE / name).read_text(encoding="utf-8")
