# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the verbs with which a render farm is used."""

import argparse

from .argument_types import argparse_type, count_from_one, path, path_text, positive, share

MAX_MEMORY_GIB = 1e6
FRAMES = "A,B-C,D-E:STEP"
CHUNK = 4  # a mesh takes less than Blender's start, so a task makes several
SCENE = {"type": path, "metavar": "X.blend", "required": True}
JOB_STORES = {"type": path, "metavar": "DIR", "help": "a farm job's stores, if its steps share imports"}


def add_submit(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `submit`."""
    from ..export.formats import parse_formats, parse_frames

    verb.add_argument("--scene", **SCENE, help="the .blend file, as it is on disk")
    verb.add_argument("--frames", type=argparse_type(parse_frames), metavar=FRAMES, help="frames (those of the scene)")
    verb.add_argument(
        "--out", type=path, required=True, metavar="DIR", help="folder for the job; frames go to DIR/frames"
    )
    verb.add_argument("--chunk", type=count_from_one, default=CHUNK, metavar="N", help=f"frames of one task ({CHUNK})")
    what = verb.add_mutually_exclusive_group()
    what.add_argument("--render", action="store_true", help="pictures, instead of meshes")
    formats = argparse_type(parse_formats)
    what.add_argument("--format", type=formats, default=("npz",), metavar="F,F", help="of the meshes (npz)")
    verb.add_argument(
        "--extension",
        type=path_text,
        metavar="ZIP",
        help="zip of the extension that each task installs; the word `installed`: pack the extension that runs now",
    )
    memory = positive(MAX_MEMORY_GIB)
    verb.add_argument("--min-memory", type=memory, default=0.0, metavar="GIB", help="memory that a worker needs (any)")
    outside = "also bring files from outside the scene's folder that are no images, height maps or stores"
    verb.add_argument("--allow-outside", action="store_true", help=outside)
    alone = "workers see no common disk: one of them imports a large missing store"
    verb.add_argument("--no-shared-disk", dest="shared_disk", action="store_false", help=alone)


def add_prepare(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `prepare`."""
    from ..export.formats import parse_frames

    verb.add_argument("--scene", **SCENE)
    frames = argparse_type(parse_frames)
    verb.add_argument("--frames", type=frames, metavar=FRAMES, help="that are to come (the scene's)")
    only = "import stores, shape land and bake maps, or a step of a farm's job that shares imports"
    parts = "stores", "land", "view", "tiles", "load", "read", "fill", "measure"
    verb.add_argument("--only", choices=parts, help=only)
    verb.add_argument("--share", type=share, metavar="K/N", help="of the tiles, with --only tiles, read, measure (all)")
    verb.add_argument("--job-stores", **JOB_STORES)


def add_render(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `render`."""
    from ..export.formats import parse_frames

    verb.add_argument("--scene", **SCENE)
    verb.add_argument("--frames", type=argparse_type(parse_frames), required=True, metavar=FRAMES)
    verb.add_argument("--out", type=path, required=True, metavar="DIR")
    verb.add_argument("--resume", action="store_true", help="leave frames that are complete as they are")
    verb.add_argument("--job-stores", **JOB_STORES)


def add_verify(verb: argparse.ArgumentParser) -> None:
    """Add the options of the verb `verify`."""
    from ..export.formats import parse_frames

    verb.add_argument("folder", type=path, help="where export or render has written them")
    verb.add_argument("--frames", type=argparse_type(parse_frames), required=True, metavar=FRAMES)
