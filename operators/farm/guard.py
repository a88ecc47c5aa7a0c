# SPDX-License-Identifier: GPL-3.0-or-later
"""Exit Blender with code 1 if it would render terrains with a stale mesh. The script does not need the extension.

    blender -b X.blend --python-exit-code 1 --python guard.py -f 1..4

A job of Open Job Description runs it without a file and with `-- ZIP FOLDER`, which installs the zip into a separate
user folder in FOLDER. After `-- --job-stores FOLDER`, terrains with an incomplete store use those of a job in FOLDER.
"""

import importlib
import os
import pathlib
import shutil
import subprocess
import sys
import tomllib
import zipfile

import bpy

VERSION = ""  # version of the extension that wrote the job; empty accepts any
USER_FOLDER = "BLENDER_USER_RESOURCES"
JOB_STORES = "--job-stores"


def one_line(text):
    """Return a text as one line without control characters, which a farm might obey."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in str(text))


def fail(message):
    """Print a message that a farm shows as the reason of the failure, and exit with code 1."""
    print(f"openjd_fail: {one_line(message)}", flush=True)
    sys.exit(1)


def install(zip_path, folder):
    """Install the zip into `folder`, with the worker's preferences, which name the graphics cards for Cycles.

    Lines on the console (openjd_env) then make later steps of the job use that folder as the user's.
    """
    if not os.path.isfile(zip_path):  # reading a pipe would wait
        fail(f"{zip_path} is no file, expected the extension's zip")
    try:
        with zipfile.ZipFile(zip_path) as archive:
            # Fails unless it is the version that wrote the job.
            check_version(tomllib.loads(archive.read("blender_manifest.toml").decode())["version"])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        fail(f"{zip_path} is not the extension's zip ({error})")
    preferences = os.path.join(bpy.utils.user_resource("CONFIG"), "userpref.blend")
    environment = {**os.environ, USER_FOLDER: folder}
    for name in ("BLENDER_USER_CONFIG", "BLENDER_USER_SCRIPTS", "BLENDER_USER_EXTENSIONS", "BLENDER_USER_DATAFILES"):
        environment.pop(name, None)
        print(f"openjd_unset_env: {name}")
    os.makedirs(os.path.join(folder, "config"), exist_ok=True)
    if os.path.isfile(preferences):
        shutil.copy(preferences, os.path.join(folder, "config"))
    how = ["extension", "install-file", "-r", "user_default", "--enable"]
    if subprocess.run([bpy.app.binary_path, "--command", *how, zip_path], env=environment).returncode:
        fail(f"the extension's zip cannot be installed: {zip_path}")
    if one_line(folder) != folder:
        fail(f"the session's folder has a name that no message can hold: {folder}")
    print(f"openjd_env: {USER_FOLDER}={folder}", flush=True)


def check_extension():
    """Fail if the extension is not enabled or has another version."""
    if not hasattr(bpy.types.Object, "adaptive_terrain"):
        fail("the extension Adaptive Terrain is not enabled in this Blender, terrains would be stale")
    check_version(getattr(extension(), "__version__", "unknown"))


def extension():
    """Return the module bl_ext.REPOSITORY.adaptive_terrain of any repository, None if it has no version."""
    modules = [module for name, module in sys.modules.items() if name.split(".")[-1] == "adaptive_terrain"]
    return next((module for module in modules if hasattr(module, "__version__")), None)


def check_version(found):
    """Fail unless a version of the extension is the one that wrote the job, and print it."""
    if VERSION and found != VERSION:
        fail(f"Adaptive Terrain {found} is here, the job was made with {VERSION}")
    print(f"Adaptive Terrain {one_line(found)}, Blender {bpy.app.version_string}", flush=True)


def absolute(path):
    """Return a path of the file as this system reads it: Blender on Windows saves backslashes."""
    found = bpy.path.abspath(path)
    return found if os.path.lexists(found) else bpy.path.abspath(path.replace("\\", "/"))


def terrains():
    """Return the terrains of the scene that is rendered."""
    objects = bpy.context.scene.objects
    return [obj for obj in objects if obj.type == "MESH" and obj.adaptive_terrain.enabled and obj.library is None]


def use_job_stores(folder):
    """Give terrains the stores that a job has made in `folder`, and fail if an incomplete one has none there."""
    package = extension().__name__
    shot_tiles = importlib.import_module(f"{package}.operators.importing.shot_tiles")
    errors = importlib.import_module(f"{package}.cbt_terrain.errors")
    try:
        shot_tiles.use_job_stores(terrains(), pathlib.Path(folder))
    except errors.TerrainError as error:
        fail(error)


def check_file():
    """Make stale renders stop Blender, and fail if the store of a terrain is missing."""
    for scene in bpy.data.scenes:
        scene.adaptive_terrain.stop_stale_renders = True
    for obj in terrains():
        store = absolute(obj.adaptive_terrain.store)
        if not os.path.isfile(os.path.join(store, "store.json")):
            fail(f"the store of {obj.name} is missing: {store}")


arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
if arguments[:1] == [JOB_STORES]:
    check_extension()
    use_job_stores(arguments[1])
    check_file()
elif arguments and arguments[0]:
    install(arguments[0], os.path.join(arguments[1], "blender"))
else:
    check_extension()
    check_file()
