# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts that a profile tells apart, and how docs/performance.md shows them. `profile.py` measures them."""

import json
from pathlib import Path

FILE = Path(__file__).with_name("profiles.json")
DESCENT, BAND_TEST, BAND = "walk: stack and branches", "walk: errors against bands", "walk: bands made"
ERRORS, BOX, PIXEL = "walk: errors read", "walk: boxes of diamonds", "walk: pixels on a box"
LEAF, BLOCK, MERGED = "walk: leaves written", "walk: even blocks", "walk: not attributed"
KEPT = "walk: subtrees kept and taken"
WELD, DISPLACE = "weld", "displace, normals, uv"
SEARCH = "search for a triangle limit"
SYSTEM, COPY, PYTHON = "the system: memory's pages", "memory copied or cleared", "Python and numpy"
OUR_WRITER, BLENDER = "our mesh writer's kernels", "Blender"
TREE, SYNC, SHADE = "Cycles: rays' tree (Embree)", "Cycles: scene taken over", "Cycles: rays and shading"
OTHER = "the rest"
# What a reader should know of each part.
MEANING = {
    DESCENT: "halving triangles, putting one aside and taking it up again",
    BAND_TEST: "a diamond's error in metres, compared with what is certain inside the band around it",
    ERRORS: "waiting for errors to come from memory, and fetching tiles ahead",
    BOX: "height ranges read, the box of a diamond made of them",
    PIXEL: "what a pixel spans at the nearest point of the box, frustum included; compared with what was asked",
    BAND: "the coarsest pixel on the box and the depths that are certain below it",
    LEAF: "words, points and cells of single leaves",
    BLOCK: "even blocks: leaves copied from a table",
    KEPT: "what the last frame has found copied, what the next one may copy noted",
    MERGED: "instructions that the compiler made of several lines",
    SEARCH: "every diamond's last step found and counted",
    WELD: "vertex numbers of corners, edges",
    DISPLACE: "samples read, positions and normals made of them",
    SYSTEM: "page faults of fresh memory, and giving it back",
    COPY: "memmove and memset, Blender's and numpy's",
    PYTHON: "what happens around the kernels",
    OUR_WRITER: "face offsets and texture coordinates written into Blender's memory",
    BLENDER: "Blender's own code",
    TREE: "the bounding boxes that rays are traced through, built and passed",
    SYNC: "Blender's mesh copied into Cycles' own arrays, normals and attributes made",
    SHADE: "the picture itself",
    OTHER: "parts below 1 % each",
}


def in_words(parts: dict[str, float]) -> str:
    """Shares in whole percents; what rounds to none is left out."""
    return ", ".join(f"{part} {100 * share:.0f} %" for part, share in parts.items() if share >= 0.005)


def section(file: Path) -> list[str]:
    """Paragraphs of the page; none where there are no profiles."""
    if not file.exists():
        return []
    content = json.loads(file.read_text(encoding="utf-8"))
    lines = ["| row | size | share of its time |", "| --- | ---: | --- |"]
    met = dict.fromkeys(part for profile in content["profiles"] for part in profile["parts"])
    for profile in content["profiles"]:
        name = profile["row"] + (f", {profile['scene']}" if profile["scene"] else "")
        lines.append(f"| {name} | {profile['size']:,} | {in_words(profile['parts'])} |")
    least = min(profile["samples"] for profile in content["profiles"])
    return [
        "## Profiles",
        f"Of the rows that miss their goals: shares of the samples that `make profile` took (Linux perf, {least:,} or "
        f"more a scene), on {content['date']}, {content['machine']['Processor']}, {content['machine']['Threads']} "
        "threads. A sample inside the walk is followed to the line of walk.py that it was compiled from. Of "
        "the rows `refine` and `depth` only the walk and the tree count, as in their times; of the others everything.",
        "\n".join(lines),
        "\n".join(f"* **{part}**: {MEANING[part]}." for part in met),
    ]
