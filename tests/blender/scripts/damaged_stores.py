# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame changes over damaged stores: FOLDER SEED COUNT WHOLE ...

Each gives a mesh that Blender finds no fault with, or one sentence while the last mesh stays. Prints what came of them.
"""

import collections
import json
import sys
from pathlib import Path

import bpy
import numpy as np
from mutants import mutate


def arrays(mesh) -> tuple[bytes, bytes]:
    """Return positions and corners, and assert that they are finite and in range."""
    positions = np.zeros(3 * len(mesh.vertices), np.float32)
    corners = np.zeros(len(mesh.loops), np.int32)
    mesh.vertices.foreach_get("co", positions)
    mesh.loops.foreach_get("vertex_index", corners)
    assert np.isfinite(positions).all()
    assert not len(corners) or (corners.min() == 0 and corners.max() == len(mesh.vertices) - 1)
    return positions.tobytes(), corners.tobytes()


def main(folder: Path, seed: int, count: int, wholes: list[str]) -> None:
    scene, outcomes = bpy.context.scene, collections.Counter()
    terrain = bpy.data.objects.new("Terrain", bpy.data.meshes.new("Terrain"))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for obj in (terrain, camera):
        scene.collection.objects.link(obj)
    scene.camera, camera.data.clip_end = camera, 1e5
    camera.location, camera.rotation_euler = (0.0, -400.0, 150.0), (1.2, 0.0, 0.0)
    settings = terrain.adaptive_terrain
    settings.enabled = True
    session = next(
        module for name, module in sys.modules.items() if name.endswith("adaptive_terrain.operators.session.session")
    )
    mutant = folder / "mutant"
    for k in range(seed, seed + count):
        rng = np.random.default_rng([64, k])
        print(k, mutate(Path(wholes[k % len(wholes)]), mutant, rng), flush=True)
        settings.store = str(mutant)
        settings.interpolation = str(rng.choice(["bilinear", "bilinear", "bicubic"]))
        detail = settings.viewport
        detail.meshlet, detail.limit_triangles, detail.max_triangles = int(rng.choice([0, 0, 1])), True, 4000
        session.clear()  # as where a file is opened
        for frame in (2 * k, 2 * k + 1):
            camera.location.x = rng.uniform(-200.0, 200.0)
            before = arrays(terrain.data)
            scene.frame_set(frame)
            error, after = session.record_of(terrain).status.error, arrays(terrain.data)
            if error:
                assert "unexpectedly" not in error and "\n" not in error, error
                assert after == before, "the last mesh did not stay"
            else:
                assert terrain.data.validate(verbose=True) is False
            outcomes["sentence" if error else "mesh"] += 1
    print("RESULT " + json.dumps(outcomes))


arguments = sys.argv[sys.argv.index("--") + 1 :]
main(Path(arguments[0]), int(arguments[1]), int(arguments[2]), arguments[3:])
