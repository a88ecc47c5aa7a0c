# SPDX-License-Identifier: GPL-3.0-or-later
"""What the session keeps of each terrain: its engine, its last results, and the status that the panel shows."""

import dataclasses
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from ...cbt_terrain.accuracy.time_correction import TimeCorrection
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import FieldKey
from ...cbt_terrain.mesh.attributes import Attribute
from ...cbt_terrain.refine.reported_bounds import ReportedBounds
from ..attributes.request import EffectStatus
from ..bridge.applied import Placed
from ..overlay.colors import Overlay
from ..scatter.request import ScatterRecord
from ..terrain.request import Request

if TYPE_CHECKING:
    from ...cbt_terrain.terrain import Terrain


@dataclasses.dataclass
class Status:
    """The last update as the panel shows it.

    Attributes:
        mode: VIEWPORT or RENDER, "" before the first update.
        request: the request, None before the first update.
        field_key: key of the height field.
        changed: whether the engine's mesh differed from the one before.
        leaves, triangles: of the engine's mesh.
        bounds: bounds of the mesh.
        triangles_left: triangles after the clean-up.
        ms: milliseconds by step.
        effects: status of attributes by name.
        effects_bytes: memory of all attributes, including their cache for the next update.
        error: text of `failure`, "" if the last update succeeded.
        failure: error of the last update.
    """

    mode: str = ""
    request: Request | None = None
    field_key: FieldKey | None = None
    changed: bool = False
    leaves: int = 0
    triangles: int = 0
    bounds: ReportedBounds = ReportedBounds()
    triangles_left: int = 0
    ms: dict[str, float] = dataclasses.field(default_factory=dict)
    effects: dict[str, EffectStatus] = dataclasses.field(default_factory=dict)
    effects_bytes: int = 0
    error: str = ""
    failure: TerrainError | None = None

    @property
    def digest(self) -> str:
        """Return a text that identifies the mesh and its views; "" before the first update."""
        return self.request.digest(self.field_key) if self.request and self.field_key else ""


@dataclasses.dataclass
class Record:
    """One terrain's engine and its last results.

    Attributes:
        terrain: the engine for `field`, None before the first update.
        field: the height field of the last update, None before the first.
        serial: number of the current surface; it grows whenever the surface changes.
        placed: the last written meshes and the object's transform with them, by number of vertices.
        shown: key of the surface in the mesh and of how it was written.
        postponed_normals: float32 [V, 3], normals that the mesh lacks because it is live; None if it has them.
        overlay: None while it is off; `overlay_key` identifies its inputs, `overlay_ms` its time.
        effects: attributes in arrays of the terrain's history, which holds `effects_bytes`.
        effects_serial: number of the current values.
        effects_status: status by name.
        effects_runs: how often each was computed.
        live_key: key of the last request of the live update, which skips an equal one; None to repeat it.
        time_correction: from updates of the live viewport.
        scatters: by the session_uid of their objects.
        generation: changes with everything that makes a running update stale.
        placed_for: path and time of change, ns, of the store whose raster the object was placed for; None if unknown.
    """

    terrain: "Terrain | None" = None
    field: object = None
    serial: int = 0
    placed: dict[int, Placed] = dataclasses.field(default_factory=dict)
    shown: tuple | None = None
    postponed_normals: np.ndarray | None = None
    overlay: Overlay | None = None
    overlay_key: tuple | None = None
    overlay_ms: float = 0.0
    effects: dict[str, Attribute] = dataclasses.field(default_factory=dict)
    effects_serial: int = 0
    effects_status: dict[str, EffectStatus] = dataclasses.field(default_factory=dict)
    effects_bytes: int = 0
    effects_runs: Counter = dataclasses.field(default_factory=Counter)
    live_key: tuple | None = None
    time_correction: TimeCorrection = dataclasses.field(default_factory=TimeCorrection)
    scatters: dict[int, ScatterRecord] = dataclasses.field(default_factory=dict)
    generation: int = 0
    placed_for: tuple[str, int] | None = None
    status: Status = dataclasses.field(default_factory=Status)
