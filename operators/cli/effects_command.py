# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain effects`: which there are, what they take on a store, and which of them a scene reads."""

from pathlib import Path

from ...cbt_terrain.attributes.attribute import GEOMETRY, AttributeRequest
from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.evaluate import EffectRequest, Ran, evaluate
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.history.frame_history import FrameHistory
from ...cbt_terrain.run import launch, stopping
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.criterion import Criterion
from ..text import effect_lines

MEASURED_TRIANGLES = 200_000
FINE_M = 1e-3  # an error so small that the limit above decides the mesh


def describe_attributes() -> dict:
    """Return the declaration of every attribute, as fields, by its name."""
    return {name: effect_lines.about(effect) for name, effect in ATTRIBUTES.items()}


def list_costs(store: Path) -> list[str]:
    """Return lines of text: the size of a mesh of the whole store, and each attribute's time and memory on it.

    The mesh has MEASURED_TRIANGLES at most. Raises TerrainError.
    """
    field = open_store(store)
    surface = Terrain(field).update(Criterion(error_px=0, error_m=FINE_M, max_triangles=MEASURED_TRIANGLES), []).surface
    lines = [f"a mesh of {len(surface.triangles):,} triangles, {len(surface.positions):,} vertices"]
    for name in ATTRIBUTES:
        stopping.check()
        lines.append(f"{name}: {effect_lines.cost_figures(_measure_attribute(name, field, surface))}")
    return lines


def _measure_attribute(name: str, field, surface):
    """Return the record of a run (time, memory) of one attribute and of the attributes that it reads.

    It is evaluated twice: the second run, which is reported, finds compiled kernels and filled caches.
    """
    planned = plan([AttributeRequest(name, readers=("this command",), family=GEOMETRY)])
    for _ in range(2):
        ran = evaluate(field, EffectRequest(planned, surface), FrameHistory(), launch.default_threads()).ran
    ms, nbytes = sum(step.ms for step in ran.values()), sum(step.nbytes for step in ran.values())
    return Ran(ms=ms, nbytes=nbytes, computed=ran[name].computed)


def list_readers(blend: Path, camera: str | None) -> list[str]:
    """Return lines of text for each terrain of a .blend file: which attributes are read, by whom, or why they are
    skipped.

    The terrains are refined as a render of the scene's current frame needs them. camera: name of the camera, None for
    the scene's.
    """
    from ..export.frame_sources import SceneFrames
    from ..session import session

    scene = SceneFrames(blend, camera, resolution=None)
    lines = []
    for piece in scene.pieces(scene.scene.frame_current):
        statuses = session.record_of(piece.obj).status.effects
        lines.append(f"{piece.name}: {len(piece.surface.triangles):,} triangles")
        lines += [f"  {effect_lines.status_line(name, status)}" for name, status in statuses.items()]
    return lines
