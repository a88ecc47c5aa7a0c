#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare the output files of two checkouts: `compare_outputs.py CHECKOUT [--record FILE] [--against FILE]`.

The script runs only the command line of the checkout's environment (`CHECKOUT/.venv/bin/adaptive-terrain`), so it works
for any layout of modules. `--record` writes the hash of each output file to FILE, and a Blender scene to FILE.scene.
`--against` reads both again: the second checkout opens the scene that the first one saved. It fails if a hash differs.
"""

import argparse
import hashlib
import io
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin

SEED = 20261126
FRAMES = "1-3"
PATH = {
    "fov": 50,
    "clip": [1, 100000],
    "keyframes": [
        {"frame": 1, "eye": [-2600, -2100, 900], "target": [0, 100, 200]},
        {"frame": 3, "eye": [-900, -1500, 600], "target": [100, 100, 250], "fov": 40},
    ],
}
STACK = {
    "version": 1,
    "entries": [
        {"effect": "rivers", "parameters": {"years": 100000}, "seed": 4},
        {"effect": "scree", "mask": {"rules": [{"of": "slope", "low": 20, "edge": 10}]}},
        {"effect": "droplets", "parameters": {"droplets": 2000}},
        {"effect": "relief"},
        {"effect": "water"},
        {"effect": "flood", "parameters": {"minutes": 5}},
        {"effect": "snow", "parameters": {"line": 200}, "mask": {"factor": 0.8}},
    ],
}
ATTRIBUTES = (
    "height,slope,aspect,mean_curvature,profile_curvature,plan_curvature,detail_normal,flow,wetness,splat_1,color,sky,"
    "ambient_occlusion,sun"
)
BY_PRODUCTS = "wear,sediment,scree,snow,slides,water_depth,water_speed,discharge"
# Export options by name of the output folder.
CRITERIA = {
    "default": [],
    "fine": ["--pixel-error", "0.5", "--shading-floor", "0.3"],
    "budget": ["--budget", "4000"],
    "meshlet": ["--meshlet", "2", "--pixel-error", "3"],
    "bicubic": ["--interpolation", "bicubic", "--detail", "2,8"],
    "morph": ["--morph", "--pixel-error", "2"],
    "attributes": ["--pixel-error", "3", "--effects", ATTRIBUTES],
}
# JSON keys that hold times or versions; "data" is the random name of a store's folder of arrays.
SKIPPED = re.compile(r"ms|.*_ms|seconds|.*time.*|.*version.*|data|machine|memory.*|generator")
# Texts that differ between two runs: absolute paths, digests of files that hold a time, and times in sentences.
VARYING = re.compile(r"^/.*|^[0-9a-f]{16,}$|\d+ ms\b")
SCENE = """
import os, sys
import adaptive_terrain, bpy
if not hasattr(bpy.types.Object, "adaptive_terrain"):
    adaptive_terrain.register()
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 640, 360
scene.render.use_lock_interface = True
bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath("scene.blend"))
obj = bpy.data.objects.new("Island", bpy.data.meshes.new("Island"))
scene.collection.objects.link(obj)
bpy.context.view_layer.objects.active = obj
obj.adaptive_terrain.enabled, obj.adaptive_terrain.store = True, "//island.store"
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(camera)
scene.camera, camera.data.clip_end = camera, 1e5
camera.rotation_euler = (1.2, 0.0, 0.0)
for frame, y in ((1, -2500.0), (3, -1500.0)):
    camera.location = (0.0, y, 900.0)
    camera.keyframe_insert("location", frame=frame)
bpy.ops.adaptive_terrain.land_add(effect="scree")
bpy.ops.adaptive_terrain.layer_preset_add()
bpy.ops.adaptive_terrain.layer_add()
bpy.ops.adaptive_terrain.terrain_material()
bpy.ops.adaptive_terrain.scatter_add()
bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath("scene.blend"))
sys.stdout.flush()
os._exit(0)
"""
# Blender writes addresses into a .blend: what counts is the meshes in it.
READ_BLEND = """
import hashlib, os, sys
import bpy, numpy as np
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
result = hashlib.blake2b(digest_size=12)
for obj in sorted(bpy.data.objects, key=lambda obj: obj.name):
    result.update(repr((obj.name, obj.type, [round(x, 6) for row in obj.matrix_world for x in row])).encode())
    for attribute in sorted(getattr(obj.data, "attributes", ()), key=lambda attribute: attribute.name):
        result.update(repr((attribute.name, attribute.domain, attribute.data_type, len(attribute.data))).encode())
        members = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color", "BYTE_COLOR": "color"}
        member = members.get(attribute.data_type, "value")
        if len(attribute.data) and hasattr(attribute.data[0], member):
            width = np.size(getattr(attribute.data[0], member))
            values = np.empty(len(attribute.data) * width, np.float64)
            attribute.data.foreach_get(member, values)
            result.update(values.tobytes())
print("hash:" + result.hexdigest())
sys.stdout.flush()
os._exit(0)
"""


def write_inputs(folder: Path) -> None:
    """Write small rasters of several formats, a camera path, a stack and points into `folder`."""
    random = np.random.default_rng(SEED)

    def hills(rows: int, columns: int) -> np.ndarray:
        y, x = np.mgrid[0:rows, 0:columns]
        return 300 + 150 * np.sin(x / 23) * np.cos(y / 17) + random.normal(0, 2, (rows, columns))

    def tiff(name: str, heights, crs, transform, **more) -> None:
        profile = {"driver": "GTiff", "count": 1, "crs": crs, "transform": transform, "dtype": heights.dtype, **more}
        with rasterio.open(folder / name, "w", height=heights.shape[0], width=heights.shape[1], **profile) as file:
            file.write(heights, 1)

    utm = hills(260, 301).astype(np.float32)
    utm[40:60, 50:90] = -9999
    tiff("utm.tif", utm, "EPSG:32632", from_origin(500000, 5200000, 10, 10), nodata=-9999, tiled=True, compress="lzw")
    tiff("degrees.tif", hills(150, 190).astype(np.int16), "EPSG:4326", from_origin(10, 46, 1 / 1200, 1 / 1200))
    hills(1201, 1201).astype(">i2").tofile(folder / "N46E010.hgt")
    np.save(folder / "doubles.npy", hills(129, 200))
    (hills(96, 128) * 80).astype("<u2").tofile(folder / "heights.raw")
    header = "ncols 90\nnrows 70\nxllcorner 4000\nyllcorner 8000\ncellsize 25\nNODATA_value -1\n"
    rows = "\n".join(" ".join(f"{z:.2f}" for z in row) for row in hills(70, 90))
    (folder / "grid.asc").write_text(header + rows + "\n")
    picture = (hills(140, 111) * 80).astype(np.uint16)
    warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
    with rasterio.open(
        folder / "picture.png", "w", driver="PNG", count=1, dtype="uint16", height=140, width=111
    ) as file:
        file.write(picture, 1)
    (folder / "path.json").write_text(json.dumps(PATH))
    (folder / "stack.json").write_text(json.dumps(STACK))
    places = random.uniform(-800, 800, (200, 2))
    (folder / "points.csv").write_text("x,y\n" + "".join(f"{x:.3f},{y:.3f}\n" for x, y in places))


def commands(formats: str) -> list[list[str]]:
    """Return the command lines in their order, without the program; paths are relative to the working folder."""
    lines = [
        ["import", "in/utm.tif", "--store", "out/utm.store"],
        ["import", "in/utm.tif", "--store", "out/holes.store", "--holes", "--height-scale", "1.5"],
        ["import", "in/degrees.tif", "--store", "out/degrees.store", "--project", "utm"],
        ["import", "in/N46E010.hgt", "--store", "out/hgt.store", "--project", "utm"],
        ["import", "in/doubles.npy", "--store", "out/npy.store", "--extent", "1990x1280", "--first-row-south"],
        ["import", "in/heights.raw", "--store", "out/raw.store", "--raw-size", "128x96", "--extent", "1270x950"],
        ["import", "in/grid.asc", "--store", "out/asc.store", "--height-offset", "-20"],
        ["import", "in/picture.png", "--store", "out/png.store", "--extent", "1100x1390", "--height-scale", "0.0125"],
        ["import", "island", "--size", "513", "--store", "out/island.store"],
        ["import", "mountains", "--size", "257", "--seed", "3", "--store", "out/mountains.store"],
        ["shape", "--store", "out/island.store", "--stack", "in/stack.json", "--out", "out/shaped.store"],
        ["shape", "--store", "out/utm.store", "--stack", "in/stack.json", "--out", "out/shaped_utm.store"]
        + ["--export", "out/shaped_utm.tif"],
        ["query", "--store", "out/utm.store", "--points", "in/points.csv", "--out", "out/points.csv"],
        ["query", "--store", "out/island.store", "--points", "in/points.csv", "--profile", "--out", "out/profile.csv"],
        ["maps", "--store", "out/island.store", "--maps", "detail_normal,sky,color", "--out", "out/maps"],
        ["maps", "--store", "out/shaped.store", "--maps", "slope,flow", "--format", "exr", "--out", "out/maps_exr"]
        + ["--path", "in/path.json", "--frames", FRAMES],
    ]
    for format_ in formats.split(","):
        lines.append(["bake", "--store", "out/utm.store", "--max-error", "3", "--out", f"out/bake.{format_}"])
    bake = ["bake", "--store", "out/mountains.store", "--max-error", "5", "--out"]
    lines += [[*bake, "out/fit.npz", "--fit"], [*bake, "out/bicubic.npz", "--interpolation", "bicubic"]]
    flight = ["export", "--path", "in/path.json", "--frames", FRAMES, "--resolution", "960x540", "--store"]
    for name, options in CRITERIA.items():
        kinds = formats if name == "default" else "npz"
        lines.append([*flight, "out/island.store", "--format", kinds, "--out", f"out/export_{name}", *options])
    more = ["--effects", BY_PRODUCTS, "--pixel-error", "3"]
    lines.append([*flight, "out/shaped.store", "--format", "npz", "--out", "out/export_shaped", *more])
    lines.append([*flight, "out/holes.store", "--format", "npz", "--out", "out/export_holes"])
    if "blend" in formats:
        lines.append(["prepare", "--scene", "out/scene/scene.blend", "--frames", FRAMES])
        scene = ["export", "--scene", "out/scene/scene.blend", "--frames", FRAMES, "--out", "out/export_scene"]
        lines.append([*scene, "--format", "npz,blend", "--scatter"])
    return lines


def plain(value):
    """Return a JSON value without times, versions, digests and sizes of files."""
    if isinstance(value, dict):
        entries = {key: item for key, item in value.items() if not SKIPPED.fullmatch(key)}
        return {key: sorted(item) if key == "files" else plain(item) for key, item in entries.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return VARYING.sub("", value) if isinstance(value, str) else value


def hash_file(path: Path, python: Path) -> str:
    """Return the hash of a file's contents, without times and versions."""
    data = path.read_bytes()
    if path.suffix == ".json":
        data = json.dumps(plain(json.loads(data)), sort_keys=True).encode()
    elif path.suffix == ".npz":
        parts = []
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in sorted(archive.namelist()):
                array = np.load(io.BytesIO(archive.read(name)), allow_pickle=False)
                content = array.tobytes()
                if array.dtype.kind in "US" or name == "info.npy":
                    content = json.dumps(plain(json.loads(str(array))), sort_keys=True).encode()
                parts.append(repr((name, array.dtype.str, array.shape)).encode() + content)
        data = b"".join(parts)
    elif path.suffix == ".glb":  # its JSON part names Blender's version
        size = struct.unpack("<I", data[12:16])[0]
        data = json.dumps(plain(json.loads(data[20 : 20 + size])), sort_keys=True).encode() + data[20 + size :]
    elif path.suffix == ".blend":
        done = subprocess.run([python, "-c", READ_BLEND, path], capture_output=True, text=True, check=True)
        return next(line[5:] for line in done.stdout.splitlines() if line.startswith("hash:"))
    return hashlib.blake2b(data, digest_size=12).hexdigest()


def run_all(checkout: Path, venv: str, work: Path, formats: str, saved_scene: Path | None) -> dict[str, str]:
    """Run all commands of a checkout in `work`; return the hash of each file below `work`/out by its path."""
    binaries = checkout.resolve() / venv / "bin"
    environment = {**os.environ, "XDG_DATA_HOME": str(work / "data"), "BLENDER_USER_RESOURCES": str(work / "blender")}
    environment.pop("PYTHONPATH", None)
    (work / "in").mkdir(parents=True)
    (work / "out").mkdir()
    write_inputs(work / "in")
    failures = []
    scene = work / "out" / "scene"
    for arguments in commands(formats):
        if arguments[0] == "prepare":
            if saved_scene:
                shutil.copytree(saved_scene, scene)
            else:
                scene.mkdir()
                shutil.copytree(work / "out" / "mountains.store", scene / "island.store")
                subprocess.run([binaries / "python", "-c", SCENE], cwd=scene, env=environment, check=True)
                shutil.copytree(scene, work / "scene")
        start = time.monotonic()
        command = [binaries / "adaptive-terrain", *arguments]
        done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True)
        print(f"{time.monotonic() - start:6.1f} s  {' '.join(arguments)}", file=sys.stderr, flush=True)
        if done.returncode:
            failures.append(" ".join(arguments))
            print(done.stderr, file=sys.stderr)
    if failures:
        raise SystemExit("failed: " + "\n        ".join(failures))
    hashes = {}
    for path in sorted((work / "out").rglob("*")):
        name = re.sub(r"/data-[0-9a-f]{32}/", "/data/", str(path.relative_to(work / "out")))
        if path.is_file() and not name.startswith("scene/scene.blend"):
            hashes[name] = hash_file(path, binaries / "python")
    return hashes


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--venv", default=".venv", help="folder of the environment in the checkout (.venv)")
    parser.add_argument("--formats", default="npz,ply,obj,glb,stl,blend", help="mesh formats; npz needs no Blender")
    parser.add_argument("--record", type=Path, help="JSON file to write")
    parser.add_argument("--against", type=Path, help="JSON file to compare with")
    parser.add_argument("--work", type=Path, help="empty folder for all files, kept (a temporary one)")
    arguments = parser.parse_args()
    saved = arguments.against and Path(f"{arguments.against}.scene")
    with tempfile.TemporaryDirectory(prefix="outputs_") as temporary:
        work = (arguments.work or Path(temporary)).resolve()
        hashes = run_all(arguments.checkout, arguments.venv, work, arguments.formats, saved)
        if arguments.record:
            arguments.record.write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n")
            if (work / "scene").exists():
                shutil.copytree(work / "scene", f"{arguments.record}.scene", dirs_exist_ok=True)
    before = json.loads(arguments.against.read_text()) if arguments.against else hashes
    different = 0
    for path in sorted(before.keys() | hashes.keys()):
        mark = "" if before.get(path) == hashes.get(path) else "  DIFFERS from " + before.get(path, "nothing")
        different += bool(mark)
        print(f"{hashes.get(path, 'missing'):>24}  {path}{mark}")
    print(f"{len(hashes)} files, {different} differ")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
