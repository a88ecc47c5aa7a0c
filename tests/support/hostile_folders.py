# SPDX-License-Identifier: GPL-3.0-or-later
"""Project folders with damage: `hostile_folders.py FOLDER FIRST COUNT` tries mutants of land folders, scenes, summaries
and other files that verbs read, and prints how many ended in which way.

Every mutant runs in a fork of one warm process. A mutant is at fault if its verb hangs, crashes, prints a traceback or
more than one error, or changes anything outside the folders that the verb may write.
"""

import json
import os
import random
import resource
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from functools import partial
from pathlib import Path

LIMIT_S = 120  # only ends a hang
JUNK = (
    None,
    True,
    -1,
    0,
    3,
    1e300,
    float("nan"),
    float("inf"),
    "x",
    "../../precious",
    "\0",
    "//precious",
    [],
    {},
    [[]],
)


def main(folder: str, first: str, count: str) -> None:
    base = Path(folder).resolve()
    scene = _make_project(base / "plain")
    ends = Counter()
    for seed in range(int(first), int(first) + int(count)):
        rng = random.Random(seed)
        work = base / f"mutant{seed}"
        shutil.copytree(base / "plain", work, symlinks=True)
        make_precious(work)
        kind = ("land", "scene", "summary", "file")[seed % 4]
        done, arguments, prepare = MUTATIONS[kind](work, scene, rng)
        writable = {work / "out", work / "gift" / "st_land"}
        if not os.path.lexists(work / "gift" / "st" / "store.json"):
            writable.add(work / "gift" / "st")  # a verb may import the store again, and remove its old arrays
        name = f"mutant {seed} ({kind}: {done}; {' '.join(arguments)})"
        end = end_of(partial(_run, prepare, arguments), partial(_contents, work, kind, writable), name)
        ends[f"{kind} {end}"] += 1
        shutil.rmtree(work)
    print(json.dumps(ends))


def make_precious(work: Path) -> Path:
    """Write files that no verb may change into a new folder; return the folder."""
    precious = work / "precious"
    (precious / "thesis").mkdir(parents=True)
    for name in ("mine.txt", "store.json", "thesis/chapter.tex"):
        (precious / name).write_text("mine")
    return precious


def end_of(do, contents, mutant: str) -> str:
    """Run `do` in a fork; return "fine" or "refused", or end the program at a fault or where `contents()` changes."""
    before = contents()
    status, text, seconds = in_fork(do)
    fault = fault_of(status, text, seconds)
    if fault is None and contents() != before:
        fault = "changed files that are not its own"
    if fault is not None:
        sys.exit(f"{mutant}: {fault}\n{text[-3000:]}")
    return "refused" if status else "fine"


def _make_project(folder: Path) -> str:
    """Make a project with a terrain, its shaped land, one exported frame and small files; returns the scene's name."""
    import numpy as np
    from adaptive_terrain import ImportSettings
    from adaptive_terrain.cbt_terrain.importing.build_store import run_import
    from adaptive_terrain.operators.blender import need_bpy

    gift = folder / "gift"
    gift.mkdir(parents=True)
    y, x = np.indices((65, 65)) / 9.0
    np.save(gift / "heights.npy", (300 * np.sin(x) * np.cos(y) + 20 * x).astype(np.float32))
    run_import(ImportSettings(str(gift / "heights.npy"), extent=(6500.0, 6500.0)), gift / "st")
    _load_kernels(gift / "st")
    bpy = need_bpy("The mutants")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, obj = bpy.context.scene, bpy.data.objects.new("T", bpy.data.meshes.new("T"))
    scene.collection.objects.link(obj)
    bpy.ops.wm.save_as_mainfile(filepath=str(gift / "x.blend"))
    obj.adaptive_terrain.enabled, obj.adaptive_terrain.store = True, "//st"
    camera = bpy.data.objects.new("C", bpy.data.cameras.new("C"))
    camera.location, camera.rotation_euler, camera.data.clip_end = (0, -3000, 2000), (1, 0, 0), 1e5
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "BLENDER_WORKBENCH", 32, 18
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.adaptive_terrain.land_add(effect="scree")
    bpy.ops.wm.save_mainfile()
    (folder / "stack.json").write_text('{"version": 1, "entries": [{"effect": "scree", "mask": {"image": "m.npy"}}]}')
    np.save(folder / "m.npy", np.ones((8, 8), np.float32))
    (folder / "points.csv").write_text("x,y\n0,0\n100,-200\n")
    frames = [{"frame": 1, "eye": [0, -5000, 2000], "target": [0, 0, 0]}]
    (folder / "flight.json").write_text(json.dumps({"fov": 50, "keyframes": frames}))
    status, text, _ = in_fork(lambda: _run(None, _export(folder)))
    assert status == 0, text
    return "gift/x.blend"


def _load_kernels(store: Path) -> None:
    """Import what verbs import, and launch a frame's kernels: else every fork would, which takes it two seconds."""
    from adaptive_terrain import Criterion, Terrain, View, open_store
    from adaptive_terrain.cbt_terrain.height_operators import shape_store  # noqa: F401
    from adaptive_terrain.operators.export import exporting, frame_sources  # noqa: F401

    Terrain(open_store(store), threads=1).update(Criterion(), [View.look((0, -3000, 2000), (0, 0, 0))])


def _export(work: Path) -> list[str]:
    return ["export", "--scene", f"{work}/gift/x.blend", "--frames", "1", "--format", "npz", "--out", f"{work}/out"]


def _land(work: Path, scene: str, rng: random.Random):
    """Replace or damage up to three things in the land's folder or the store's."""
    found = [p for top in ("st_land", "st") for p in (work / "gift" / top, *sorted((work / "gift" / top).rglob("*")))]
    done = "; ".join(replace_entry(rng.choice(found), work / "precious", rng) for _ in range(rng.choice((1, 1, 2, 3))))
    verbs = [
        [*_export(work), "--pixel-error", "5"],
        ["prepare", "--scene", f"{work}/{scene}"],
        ["render", "--scene", f"{work}/{scene}", "--frames", "1", "--out", f"{work}/out"],
        ["submit", "--scene", f"{work}/{scene}", "--out", f"{work}/out/job"],
        ["effects", "--scene", f"{work}/{scene}"],
    ]
    return done, rng.choice(verbs), None


def _scene(work: Path, scene: str, rng: random.Random):
    """Open the scene, set odd values, save it, and run a verb on it."""
    os.mkfifo(work / "gift" / "pipe")
    paths = [
        "",
        "//",
        "//pipe",
        "//../precious",
        "//st/../../precious",
        "//x.blend",
        "//" + "a" * 300,
        "//" + "a/" * 3000,
    ]
    paths += [
        "C:\\x\\y",
        "//st\n",
        "//missing",
        "/dev/zero",
        "//heights.npy",
        "//st/store.json",
        "//st\\",
        "//..\\precious",
    ]
    values = [1e30, -1.0, 0.0, float("nan"), float("inf"), 1e-30, 1, 2**31 - 1, -(2**31)]

    def prepare() -> None:
        import bpy

        bpy.ops.wm.open_mainfile(filepath=f"{work}/{scene}")
        obj, camera = bpy.data.objects["T"], bpy.data.objects["C"]
        settings = obj.adaptive_terrain
        for _ in range(rng.choice((1, 2, 4))):
            holder = rng.choice([settings, settings.viewport, settings.render, settings.maps, settings.land.entries[0]])
            holder = rng.choice([holder, holder, obj, camera, bpy.context.scene.render])
            names = [p.identifier for p in holder.bl_rna.properties if not p.is_readonly and p.type in SETTABLE]
            name = rng.choice(names)
            kind = holder.bl_rna.properties[name].type
            value = rng.choice(paths) if kind == "STRING" else rng.choice((True, False)) if kind == "BOOLEAN" else None
            value = rng.choice(values) if value is None else value
            try:
                setattr(holder, name, int(value) if kind == "INT" else value)
            except (TypeError, ValueError, OverflowError, AttributeError, RuntimeError):
                pass  # Blender refuses the value
        bpy.ops.wm.save_mainfile()

    verbs = [_export(work), ["prepare", "--scene", f"{work}/{scene}"], ["effects", "--scene", f"{work}/{scene}"]]
    return "settings", rng.choice(verbs), prepare


SETTABLE = ("STRING", "BOOLEAN", "FLOAT", "INT")


def _summary(work: Path, scene: str, rng: random.Random):
    """Damage the summary of a frame, or its mesh."""
    file = work / "out" / rng.choice(["frame_0001.json", "frame_0001.json", "T_0001.npz"])
    done = damage_text(file, rng) if rng.random() < 0.7 else replace_entry(file, work / "precious", rng)
    verify = ["verify", f"{work}/out", "--frames", "1"]
    return done, rng.choice([verify, [*_export(work), "--resume"]]), None


def _file(work: Path, scene: str, rng: random.Random):
    """Damage a file that a verb of the command line is given."""
    store = ["--store", f"{work}/gift/st"]
    verbs = {
        "stack.json": ["shape", *store, "--stack", f"{work}/stack.json", "--out", f"{work}/out/shaped"],
        "m.npy": ["shape", *store, "--stack", f"{work}/stack.json", "--out", f"{work}/out/shaped"],
        "points.csv": ["query", *store, "--points", f"{work}/points.csv"],
        "flight.json": ["export", *store, "--path", f"{work}/flight.json", "--frames", "1", "--format", "npz"]
        + ["--out", f"{work}/out/flight"],
    }
    name = rng.choice(sorted(verbs))
    file = work / name
    done = damage_text(file, rng) if rng.random() < 0.8 else replace_entry(file, work / "precious", rng)
    return done, verbs[name], None


MUTATIONS = {"land": _land, "scene": _scene, "summary": _summary, "file": _file}


def replace_entry(path: Path, precious: Path, rng: random.Random) -> str:
    """Put a link, a pipe, a folder or other bytes in the place of `path`."""
    if not os.path.lexists(path) or any(parent.is_symlink() for parent in path.parents):
        return f"{path.name} was gone"
    how = rng.choice(
        ["link", "link", "file link", "hard link", "pipe", "folder", "guest", "junk", "cut", "gone", "loop"]
    )
    old = path.read_bytes() if path.is_file() and not path.is_symlink() else b"old"
    if how == "guest" and path.is_dir():
        (path / "guest.txt").write_text("a user's own")
        return f"{path.name} guest"
    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    if how == "link":
        path.symlink_to(os.path.relpath(precious, path.parent) if rng.random() < 0.5 else precious)
    elif how == "file link":
        path.symlink_to(precious / "mine.txt")
    elif how == "hard link":
        os.link(precious / "mine.txt", path)
    elif how == "pipe":
        os.mkfifo(path)
    elif how in ("folder", "guest"):
        path.mkdir()
    elif how == "junk":
        path.write_bytes(rng.randbytes(rng.randrange(5000)))
    elif how == "cut":
        path.write_bytes(old[: rng.randrange(len(old) + 1)])
    elif how == "loop":
        path.symlink_to(path.name)
    return f"{path.name} {how}"


def damage_text(file: Path, rng: random.Random) -> str:
    """Change bytes, an entry or the structure of a text file."""
    raw = bytearray(file.read_bytes())
    how = rng.choice(["bytes", "cut", "twice", "entry", "entry", "deep", "nothing", "codes"])
    if how == "entry":
        try:
            content = json.loads(raw)
        except (ValueError, RecursionError):  # damaged or too deep already
            how = "bytes"
        else:
            place = content
            while isinstance(place, dict | list) and place:
                key = rng.choice(list(place)) if isinstance(place, dict) else rng.randrange(len(place))
                if rng.random() < 0.5 or not isinstance(place[key], dict | list):
                    place[key] = rng.choice(JUNK)
                    break
                place = place[key]
            raw = bytearray(json.dumps(content).encode())
    if how == "bytes":
        for _ in range(rng.choice((1, 3, 30))):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
    elif how == "cut":
        raw = raw[: rng.randrange(len(raw))]
    elif how == "twice":
        raw = raw + raw
    elif how == "deep":
        raw = b"[" * 100_000
    elif how == "nothing":
        raw = b""
    elif how == "codes":
        raw = bytes(raw).decode(errors="replace").encode(rng.choice(["utf-16", "utf-32", "utf-8-sig"]))
    file.write_bytes(raw)
    return f"{file.name} {how}"


def _contents(work: Path, kind: str, writable: set[Path]) -> dict:
    """Return names, kinds, links, bytes and times of all that no verb may change."""
    found = {}
    for folder, folders, files in os.walk(work):
        at = Path(folder)
        if at in writable:
            folders.clear()
            if not at.is_symlink():
                found |= {str(p): p.read_text() for p in at.rglob("guest.txt")}
                continue
        for name in (*folders, *files):
            path = at / name
            if path in writable and not path.is_symlink():
                continue  # the verb may make them
            if at == work / "gift" and kind == "scene" and name not in ("heights.npy", "pipe"):
                continue  # the settings may name new folders there
            status = path.lstat()
            times = () if path.is_dir() else (status.st_mtime_ns, status.st_size)
            content = path.read_bytes() if path.is_file() and not path.is_symlink() and "precious" in folder else b""
            link = os.readlink(path) if path.is_symlink() else ""
            found[str(path)] = (status.st_mode, times, content, link)
    return found


def _run(prepare, arguments: list[str]) -> int:
    from adaptive_terrain.operators.cli import command_line

    if prepare is not None:
        prepare()
    return command_line.main(arguments)


def in_fork(do) -> tuple[int, str, float]:
    """Return the exit status of `do` in a fork (-1 after LIMIT_S), its output and its seconds."""
    read, write = os.pipe()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(write, 1)
        os.dup2(write, 2)
        os.close(read)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        status = 97
        try:
            status = do()
        except SystemExit as end:
            status = end.code
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status or 0)
    os.close(write)
    os.set_blocking(read, False)
    text, ended = b"", False
    while not ended:
        ended = os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None
        if not ended and time.monotonic() - start > LIMIT_S:
            os.killpg(child, signal.SIGKILL)
            ended = True
        time.sleep(0.005)
        try:
            while part := os.read(read, 65536):
                text += part
        except BlockingIOError:
            pass
    os.close(read)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return status, text.decode(errors="replace"), time.monotonic() - start


def fault_of(status: int, text: str, seconds: float) -> str | None:
    if seconds > LIMIT_S:
        return "hangs"
    if status not in (0, 1, 2):
        return f"exit status {status}"
    if "Traceback" in text:
        return "prints a traceback"
    errors = [line for line in text.splitlines() if "error: " in line]
    if status == 1 and len(errors) != 1:
        return f"ends with {len(errors)} errors"
    return None


if __name__ == "__main__":
    main(*sys.argv[1:])
