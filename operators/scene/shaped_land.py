# SPDX-License-Identifier: GPL-3.0-or-later
"""What there is to say of a terrain's land: what its mesh shows of the stack, what that took, what it leaves behind."""

import functools
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.land.derived_store import preview_of
from ...cbt_terrain.land.land_folder import folder_beside, is_of_views
from ...cbt_terrain.land.level_plan import MOST_WHOLE
from ...cbt_terrain.land_effects.catalogue import LAND_EFFECTS
from ...cbt_terrain.land_effects.land_effect import LandLayer
from ..properties.land_properties import EVERYWHERE
from ..properties.scene_paths import absolute_path
from ..request.imported import imported_of
from ..text.numbers import length_text, plain
from . import session

SOURCE, PREVIEW, SHAPED = "Source", "Preview", "Shaped"
FAILED = "Failed"
SMALL_M = 500.0
NOTES = {
    SOURCE: "Not shown: hidden, frozen, or without Live Update",
    FAILED: "Not shown: read why, above",
    PREVIEW: "Gets finer where you look when it rests; a render has all of it",
}

DOUBTFUL = "{} may not fit from tile to tile: "
DOUBTFUL += f"harder rock may help, or {MOST_WHOLE:,} samples a side at most"
WHOLE = ", but for {}, whose tiles would be off"


@dataclass(frozen=True)
class State:
    """`active`: whether anything is switched on. `shown`: what the mesh was made of. `step_m`: metres between the
    samples that the stack was applied to. `tiles`: built, and there are. `ms`: milliseconds by the entries' numbers.
    `finished_early`: finer levels were not waited for. `seen`: only what a shot sees is fine, and that may be
    another place by now."""

    active: bool = False
    shown: str = SOURCE
    step_m: float = 0.0
    tiles: tuple[int, int] | None = None
    ms: dict[int, float] = field(default_factory=dict)
    note: str = ""
    finished_early: bool = False
    seen: bool = False

    @property
    def total_ms(self) -> float | None:
        return sum(self.ms.values()) if self.ms else None

    @property
    def wanted(self) -> bool:
        """Whether there is something to shape."""
        return self.active and (self.shown != SHAPED or self.finished_early or self.seen)


def store_of(obj) -> str:
    """The folder of the heights that a terrain's mesh shows, or of its source where it shows a preview or nothing."""
    source = absolute_path(obj.adaptive_terrain.store)
    request = session.record_of(obj).status.request
    shown = _shown(request) if request is not None else ""
    return shown if Path(shown).parent == folder_beside(source) else source


def _shown(request) -> str:
    """The store that a request's mesh is made of; "" of a preview."""
    if request.land is None:
        return request.store
    return request.land.folder if request.land.waits else ""


def active_numbers(land) -> list[int]:
    """The entries of a terrain's settings that do anything."""
    return [n for n, e in enumerate(land.entries) if e.on and (e.mask.kind == EVERYWHERE or e.mask.factor > 0.0)]


def state_of(obj) -> State:
    """As of the last update of the terrain."""
    numbers = active_numbers(obj.adaptive_terrain.land)
    if not numbers:
        return State()
    state, found = _as_updated(obj, numbers), imported_of(obj.adaptive_terrain)
    state = replace(state, seen=is_of_views(store_of(obj)))
    longer = max(found.extent_m) if found is not None else SMALL_M
    if longer < SMALL_M:  # as the Add menu's own
        state = replace(state, note=f"Effects are in metres, and the terrain has {length_text(longer)}: set its Size")
    return state


def _as_updated(obj, numbers: list[int]) -> State:
    request = session.record_of(obj).status.request
    if request is not None and request.land is not None and not request.land.waits:
        found = preview_of(request.land)
        if found is not None:
            note = f"{found.without} takes too long for a preview: Shape Now" if found.without else NOTES[PREVIEW]
            return State(True, PREVIEW, found.step_m, None, _by_number(numbers, found.ms), note)
    made = _made_of(_shown(request)) if request is not None and _shown(request) else None
    if made is None:
        return State(True, note=NOTES[FAILED if session.record_of(obj).status.error else SOURCE])
    tiles, note = (sum(map(len, made.tiles)), sum(made.tile_counts)), ""
    if made.doubtful:
        note = DOUBTFUL.format(made.doubtful)
    elif made.left_out_most_m > 0.0:
        all_the_same = WHOLE.format(made.beyond_asked) if made.beyond_asked else ""
        size = f"about {plain(made.left_out_rms_m)} m, {plain(made.left_out_most_m)} m at most"
        note = f"Finer levels are left out{all_the_same}: {size}"
    return State(True, SHAPED, made.step_m, tiles, _by_number(numbers, made.ms), note, made.finished_early)


def _by_number(numbers: list[int], ms) -> dict[int, float]:
    return dict(zip(numbers, ms, strict=False))  # the list may have changed since the update


@dataclass(frozen=True)
class _Made:
    """What a shaped store says of how it was made; see Shaped in land/shape.py."""

    step_m: float
    ms: tuple[float, ...]
    tiles: list
    tile_counts: list
    left_out_rms_m: float
    left_out_most_m: float
    finished_early: bool
    doubtful: str  # an effect whose tiles are not to be trusted, or ""
    beyond_asked: str  # an effect that makes levels in one piece of which only some tiles were asked for, or ""


def _made_of(store: str) -> _Made | None:
    """None of a source's store."""
    try:
        return _read(store, (Path(store) / stores.JSON_NAME).stat().st_mtime_ns)
    except OSError:
        return None


@functools.lru_cache(maxsize=64)
def _read(store: str, _changed_ns: int) -> _Made | None:
    try:
        said = stores.read_json(Path(store))["provenance"]["shaped"]
        ms = [0.0] * (1 + max((added["entry"] for added in said["added"]), default=-1))
        for added in said["added"]:
            ms[added["entry"]] += added["ms"]
        names = ("tiles", "tile_counts", "left_out_rms_m", "left_out_most_m", "finished_early")
        step_m = min((added["spacing_m"] for added in said["added"]), default=0.0)
        some = {level for level, tiles in enumerate(said["tiles"]) if len(tiles) < said["tile_counts"][level]}
        whole = (_label(added["effect"]) for added in said["added"] if added["whole"] and added["level"] in some)
        doubtful = next((_label(added["effect"]) for added in said["added"] if added.get("doubtful", False)), "")
        return _Made(step_m, tuple(ms), *(said[name] for name in names), doubtful, next(whole, ""))
    except (TerrainError, KeyError, IndexError, TypeError, AttributeError):  # a provenance may hold anything
        return None


def _label(effect: str) -> str:
    return LAND_EFFECTS[effect].label if effect in LAND_EFFECTS else effect


def layers_of(land) -> list[LandLayer]:
    """By-products of the entries that are switched on, each once."""
    effects = [
        LAND_EFFECTS[land.entries[n].effect] for n in active_numbers(land) if land.entries[n].effect in LAND_EFFECTS
    ]
    return list({layer.name: layer for effect in effects for layer in effect.layers}.values())
