# SPDX-License-Identifier: GPL-3.0-or-later
"""Definitions of the words on the page of `accuracy`."""

WORDS = [
    ("requested", "The error that the mesh was refined for."),
    (
        "bound",
        "The promise of the refinement: no visible point of the terrain (pixels), no point at all (metres) has a "
        "larger error. It includes the rounding of float32 and of the source.",
    ),
    (
        "measured",
        "The largest error that was found against the height field of the store, which has the source's rounding in "
        "it. In pixels: over visible points, at least one a pixel and every sample in view. In metres: the exact "
        "largest distance in height between mesh and reference surface.",
    ),
    (
        "ms",
        "Elapsed time of the fastest of several warm updates, between which the camera moves by two thousandths of the "
        "terrain, as in a flight. A fit is made once; its time is that run.",
    ),
    (
        "ms of CPU",
        "Processor time of all threads, of the same update: runs are compared by it, and plots and the sentence on "
        "half the error show it. A pale bar goes from the fastest to the slowest run. Where these differ by more than "
        "a factor of 2 there is no curve.",
    ),
    ("depth", "A limit of bisections of a root square."),
    ("meshlet m", "Each leaf is drawn as 4^m triangles."),
    ("smooth, not smooth", "With Geomorph, or without it, where the other rows are the other way round."),
    ("fitted", "Vertices are moved off the surface, within the bound."),
    (
        "geometric, precision, source",
        "The parts of a bound: the share of the triangles, that of float32 positions, and that of the source's "
        "rounding.",
    ),
    ("hidden", "Points behind other ground in the picture."),
    (
        "silhouette",
        "How far the outline is displaced. It is followed by rays a pixel apart, so it alone may pass the bound where "
        "outlines are finer than that.",
    ),
    ("popping", "How far points jump from one frame's mesh to the next frame's; no figure where no frame follows."),
    (
        "shading change",
        "The largest change of a pixel's shading from one frame's mesh to the next frame's: 255 times the distance "
        "between the two unit normals, the most that any light shows on white ground.",
    ),
    ("rounding", "What float32 has changed of the measured error."),
    ("faces, shading", "Angles of triangles to the surface's normals, and of the normals that are rendered."),
    (
        "Pareto front",
        "Rings in a plot. Every setting that costs less, with the same interpolation, has an error that is larger by a "
        "fiftieth at least. Fits, which are made once, take part for triangles only.",
    ),
    (
        "the triangle limit",
        "A sweep makes no mesh of more than 8.4 million triangles; finer rows are held back by that.",
    ),
    (
        "steps",
        "refine decides and lists the leaves; mark writes the tree; weld makes vertices and edges; displace positions "
        "and normals; ingest Blender's mesh. engine is all but ingest, with the time between its steps.",
    ),
]
