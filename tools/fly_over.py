# SPDX-License-Identifier: GPL-3.0-or-later
"""A fly-over of the demo's island as a farm renders it: `fly_over.py --demo demo --blender PROGRAM --out DIR`.

The island that `make demo` has left gets a longer flight and trees. Its job, written by `submit`, is run by a worker of
Open Job Description in the real program: frames in random order in four chunks. Then some frames are rendered again,
each alone, and compared. Figures go to docs/fly_over.json, from which docs/animation.md has them.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from adaptive_terrain.operators.blender import need_bpy
from adaptive_terrain.operators.demo.demo import FLIGHT
from adaptive_terrain.operators.text.page_blocks import Heading, Table, Text
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "fly_over.json"
SECONDS, RATE, CHUNKS = 10, 24, 4
RESOLUTION = (480, 270)
SAMPLES = 8
AGAIN = 4  # frames
SEED = 17
SHOWN = 5  # frames of the strip
ERROR_PX = 1.0
TREE_M, SPACING_M, FULL_UNTIL_M = 12.0, 8.0, 900.0
GREENS = ((0.030, 0.060, 0.018, 1.0), (0.045, 0.075, 0.020, 1.0), (0.024, 0.050, 0.022, 1.0))


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--demo", type=Path, default=ROOT / "demo", help="what `make demo` has written")
    parser.add_argument("--blender", default=str(ROOT / ".cache" / "blender.run") + " blender")
    parser.add_argument("--out", type=Path, default=ROOT / "fly_over")
    parser.add_argument("--frames", type=int, default=SECONDS * RATE)
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    build(arguments.demo.resolve(), out, arguments.frames)
    figures = run(out, arguments.blender.split(), arguments.frames)
    FIGURES.write_text(json.dumps(figures, indent=1) + "\n")
    strip(out, arguments.frames).save(ROOT / "docs" / "images" / "fly_over.jpg", quality=85)
    return 0 if figures["same"] == figures["again"] else 1


def build(demo: Path, out: Path, frames: int) -> None:
    """Build the demo's island with its flight and trees, and save it as fly_over.blend."""
    need_bpy("The fly-over")
    import bpy
    from adaptive_terrain.cbt_terrain.view.camera_path import read_camera_path
    from adaptive_terrain.cbt_terrain.view.criterion import Criterion
    from adaptive_terrain.operators.demo import scene as demo_scene

    last = FLIGHT["keyframes"][-1]["frame"]
    keys = [key | {"frame": 1 + (key["frame"] - 1) * (frames - 1) // (last - 1)} for key in FLIGHT["keyframes"]]
    (out / "flight.json").write_text(json.dumps(FLIGHT | {"keyframes": keys}))
    path = read_camera_path(out / "flight.json")
    scene, terrain = demo_scene.build(
        out, demo / "store", path, range(1, frames + 1), RESOLUTION, Criterion(error_px=ERROR_PX)
    )
    scene.render.fps = RATE
    scene.cycles.use_denoising, scene.cycles.samples = False, SAMPLES  # Debian's Blender has no denoiser
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGB"
    plant(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "fly_over.blend"))


def plant(terrain) -> None:
    """Scatter trees where the material has its forest."""
    import bpy

    trees = bpy.data.collections.new("Trees")
    for number, green in enumerate(GREENS):
        material = bpy.data.materials.new(f"Needles {number}")
        material.diffuse_color = green
        material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = green, 0.9
        bpy.ops.mesh.primitive_cone_add(vertices=7, radius1=0.2 + 0.03 * number, depth=1.0, location=(0, 0, 0.5))
        tree = bpy.context.object
        tree.name = f"Tree {number}"
        bpy.ops.object.transform_apply(location=True)
        tree.data.materials.append(material)
        for collection in list(tree.users_collection):
            collection.objects.unlink(tree)
        trees.objects.link(tree)
    bpy.context.view_layer.objects.active = terrain
    bpy.ops.adaptive_terrain.scatter_add()
    [scatter] = [obj for obj in bpy.data.objects if obj.adaptive_scatter.enabled]
    settings, modifier = scatter.adaptive_scatter, scatter.modifiers[0]
    settings.spacing, settings.full_until, settings.layer = SPACING_M, FULL_UNTIL_M, "Forest"
    settings.size, settings.margin_m = TREE_M, 2 * TREE_M
    sockets = {item.name: item.identifier for item in modifier.node_group.interface.items_tree}
    if hasattr(modifier, "properties"):  # Blender 5.2
        getattr(modifier.properties.inputs, sockets["Collection"]).value = trees
    else:
        modifier[sockets["Collection"]] = trees


def run(out: Path, blender: list[str], frames: int) -> dict:
    """Submit, render in four chunks of random frames, verify, render some frames again alone; the figures."""
    worker = Worker(out, blender)
    zip_path = worker.extension()
    worker.blender("--command", "extension", "install-file", "-r", "user_default", "--enable", zip_path)
    scene = "--scene", out / "fly_over.blend"
    options = "--frames", f"1-{frames}", "--chunk", -(-frames // CHUNKS), "--extension", zip_path, "--render"
    worker.blender("--command", "adaptive_terrain", "submit", *scene, "--out", out / "job", *options)
    order = random.Random(SEED).sample(range(1, frames + 1), frames)
    chunks = [sorted(order[number::CHUNKS]) for number in range(CHUNKS)]
    random.Random(SEED).shuffle(chunks)
    started = time.monotonic()
    worker.job("Import")
    worker.job("MapsAndLand")
    prepared = time.monotonic()
    for chunk in chunks:
        worker.job("Render", "--tasks", json.dumps([{"Frame": ",".join(map(str, chunk))}]))
    rendered = time.monotonic()
    worker.job("Verify")
    again = sorted(random.Random(SEED + 1).sample(order, AGAIN))
    for frame in again:
        worker.blender("--command", "adaptive_terrain", "render", *scene, "--frames", frame, "--out", out / "again")
    pictures = [(out / place / f"frame_{frame:04d}.png" for place in ("job/frames", "again")) for frame in again]
    files = [out / "job/frames" / f"frame_{frame:04d}.json" for frame in range(1, frames + 1)]
    summaries = [json.loads(file.read_text()) for file in files]
    triangles = [terrain["triangles"] for summary in summaries for terrain in summary["terrains"]]
    return {
        "frames": frames,
        "chunks": CHUNKS,
        "resolution": RESOLUTION,
        "prepare_s": round(prepared - started, 1),
        "frame_s": round((rendered - prepared) / frames, 2),
        "triangles": [min(triangles), max(triangles)],
        "bound_px": max(terrain["bound_px"] for summary in summaries for terrain in summary["terrains"]),
        "again": AGAIN,
        "same": sum(np.array_equal(*(np.asarray(Image.open(path)) for path in pair)) for pair in pictures),
    }


class Worker:
    """The real program, and openjd's worker, with a private user folder in `out`."""

    def __init__(self, out: Path, blender: list[str]):
        self.out, self.command = out, blender
        user = out / "user"
        (user / "home").mkdir(parents=True, exist_ok=True)
        self.environment = os.environ | {
            "BLENDER_USER_RESOURCES": str(user),
            "HOME": str(user / "home"),
            "WARP_CACHE_PATH": str(user / "kernels"),
            "BIND": str(out),
            "PYTHONPATH": "",
        }
        self.program = out / "blender"
        self.program.write_text(f'#!/bin/sh\ncd {ROOT} && exec {" ".join(blender)} "$@"\n')
        self.program.chmod(0o755)

    def extension(self) -> Path:
        """Build the extension's zip."""
        command = [sys.executable, ROOT / "tools" / "build_extension.py", "--output", self.out / "dist"]
        subprocess.run([*command, "--blender", self.program], check=True, env=self.environment, cwd=ROOT)
        return next((self.out / "dist").glob("*.zip"))

    def blender(self, *arguments) -> None:
        """Run the Blender program."""
        subprocess.run([self.program, *map(str, arguments)], check=True, env=self.environment, cwd=ROOT)

    def job(self, step: str, *arguments: str) -> None:
        """Run a step of the farm's job."""
        parameters = json.loads((self.out / "job" / "parameter_values.yaml").read_text())["parameterValues"]
        values = {item["name"]: str(item["value"]) for item in parameters} | {
            "Blender": str(self.program),
            "ExtensionZip": "",
        }
        command = [sys.executable, "-c", "from openjd.cli import main; main()", "run", self.out / "job/template.yaml"]
        command += ["--step", step, *arguments, "--job-param", json.dumps(values)]
        subprocess.run(command, check=True, env=self.environment, cwd=ROOT)


def strip(out: Path, frames: int) -> Image.Image:
    """Some frames side by side, in two rows from left to right."""
    chosen = [1 + (frames - 1) * k // (SHOWN * 2 - 1) for k in range(SHOWN * 2)]
    width, height = RESOLUTION
    whole = Image.new("RGB", (SHOWN * width // 2, height))
    for k, frame in enumerate(chosen):
        with Image.open(out / "job/frames" / f"frame_{frame:04d}.png") as picture:
            small = picture.convert("RGB").resize((width // 2, height // 2), Image.Resampling.LANCZOS)
        whole.paste(small, (k % SHOWN * (width // 2), k // SHOWN * (height // 2)))
    return whole


def farm_section(path: Path) -> list:
    """Return the section of docs/animation.md about the last run."""
    f = json.loads(path.read_text())
    rows = [
        [
            "frames, in random order",
            f"{f['frames']:,} in {f['chunks']} chunks, {f['resolution'][0]} x {f['resolution'][1]} pixels",
        ],
        ["ahead of the frames (guard, store, maps)", f"{f['prepare_s']:g} s"],
        ["a frame, with starting the program", f"{f['frame_s']:g} s"],
        ["triangles of a frame", f"{f['triangles'][0]:,} to {f['triangles'][1]:,}"],
        ["largest bound of a frame", f"{f['bound_px']:.3g} px"],
        ["frames rendered again, alone", f"{f['again']}, of which {f['same']} are the same pixels"],
    ]
    return [
        Heading("A farm"),
        Text(
            "A fly-over of the demo's island, 10 s with trees, *Geomorph* on: its job was written by "
            "`submit` and run by a worker of Open Job Description in Blender 4.3, frames in random order "
            "([jobs, steps and guards](howto/farm.md)). `make fly-over` does it again."
        ),
        Table(["", ""], rows),
        Text("![Ten frames of the fly-over](images/fly_over.jpg)"),
    ]


if __name__ == "__main__":
    sys.exit(main())
