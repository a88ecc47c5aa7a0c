# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of a terrain's land for the panel: the stack in its mesh, its cost and its layers.

Shaped land is a store in a folder beside the imported store (`folder_beside`). A request without `land` shows its
`store`. One with `land` shows the shaped land if `land.waits`, else a preview, which the engine computes coarsely.
"""

import functools
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field import store as stores
from ...cbt_terrain.field.heightfield import HeightField, anchored
from ...cbt_terrain.height_operators.catalogue import operator_of
from ...cbt_terrain.height_operators.derived_store import Land, preview_of
from ...cbt_terrain.height_operators.height_operator import LandLayer
from ...cbt_terrain.height_operators.land_folder import folder_beside, is_of_views
from ...cbt_terrain.height_operators.level_plan import MAX_WHOLE
from ...cbt_terrain.height_operators.shaping_cost import estimate_seconds
from ..bridge.evaluated import anchor_of
from ..bridge.scene_paths import absolute_path
from ..importing.imported import imported_of
from ..session import session
from ..text.numbers import length_text, plain
from ..text.translations import phrase
from . import render_wait
from .properties import EVERYWHERE
from .request import land_of

SOURCE, PREVIEW, SHAPED = "Source", "Preview", "Shaped"
FAILED = "Failed"
SMALL_M = 500.0  # longer side below which a terrain was probably not meant in metres
NOTES = {
    SOURCE: "Not shown yet: press Update or Shape Now",
    FAILED: "Not shown: see the error above",
    PREVIEW: "Refined in view while nothing changes; a render has all of it",
}

DOUBTFUL = "{} may not fit from tile to tile: harder rock may help, or {} samples a side at most"
LEFT_OUT = "Finer levels are left out: about {} m, {} m at most"
LEFT_OUT_BUT = "Finer levels are left out, except {}, whose tiles would not fit: about {} m, {} m at most"


@dataclass(frozen=True)
class LandState:
    """The state of a terrain's land.

    Attributes:
        active: any entry is on.
        shown: SOURCE, PREVIEW or SHAPED: the data of the mesh.
        step_m: metres between the samples that the stack was applied to.
        tiles: number of built and of all tiles, None for a preview or the source.
        ms: milliseconds by the entries' positions in the list, None for an entry whose tiles were all cached.
        note: sentence below the figures, "" for none.
        finished_early: finer levels were not computed.
        seen: only the land in view of a shot is fine, and the shot may have changed.
    """

    active: bool = False
    shown: str = SOURCE
    step_m: float = 0.0
    tiles: tuple[int, int] | None = None
    ms: dict[int, float | None] = field(default_factory=dict)
    note: str = ""
    finished_early: bool = False
    seen: bool = False

    @property
    def wanted(self) -> bool:
        """Return whether Shape Now would do anything."""
        return self.active and (self.shown != SHAPED or self.finished_early or self.seen)


def render_wait_of(obj) -> render_wait.LandWait | None:
    """Return the shaping of this terrain's land that a render waits for, None if there is none."""
    wait = render_wait.waiting
    source = absolute_path(obj.adaptive_terrain.store)
    return wait if wait is not None and Path(wait.folder).parent == folder_beside(source) else None


def seconds_to_shape(obj) -> float | None:
    """Return the estimated seconds of Shape Now for a terrain that shows a preview, None without an estimate."""
    request = session.record_of(obj).status.request  # of the last update
    if request is None or request.land is None or request.land.waits:
        return None
    beside = folder_beside(request.land.source)  # its time of change is part of the key of the cached estimate
    try:
        return _estimate_seconds(request.land, beside.stat().st_mtime_ns if beside.exists() else 0)
    except (TerrainError, OSError):
        return None


@functools.lru_cache(maxsize=64)
def _estimate_seconds(land: Land, _changed_ns: int) -> float | None:
    """Return the expected seconds of shaping land, None if they are unknown. Raises TerrainError or OSError.

    `_changed_ns`: last change of its folder, part of the cache's key.
    """
    return estimate_seconds(land.source, land.stack, preview_of(land), land.of_views)


def _why_not_shown(obj) -> str:
    """Return a sentence about why the mesh does not show the stack; the first reason that applies."""
    if session.record_of(obj).status.error:
        return phrase(NOTES[FAILED])
    if render_wait_of(obj) is not None:
        return phrase("A render shapes it now")
    settings = obj.adaptive_terrain
    if settings.frozen:
        return phrase("Not shown: frozen")
    if obj.hide_viewport or not obj.visible_get():
        return phrase("Not shown: hidden")
    return phrase(NOTES[SOURCE]) if settings.live else phrase("Not shown: Live Update is off")


def store_of(obj) -> str:
    """Return the store that a terrain's mesh shows: shaped land, or the imported store for a preview or without a
    stack.
    """
    source = absolute_path(obj.adaptive_terrain.store)
    shown = _shaped_store(session.record_of(obj).status.request)
    # The user may have chosen another source since the request.
    return shown if Path(shown).parent == folder_beside(source) else source


def field_of(obj) -> HeightField:
    """Return the height field of `store_of` in the space of a terrain's object. Raises TerrainError."""
    return anchored(session.open_field(store_of(obj)), *anchor_of(obj))


def finished_field_of(obj, depsgraph) -> tuple[HeightField, bool]:
    """Return a height field as `field_of`, but of shaped land that is finished even if no mesh shows it yet.

    Also return whether the land is shaped, or has no stack; otherwise the field has the imported heights. Raises
    TerrainError without a store.
    """
    store, is_final = absolute_path(obj.adaptive_terrain.store), False
    with suppress(TerrainError):  # an entry is invalid
        land = land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
        shaped = store if land is None else land.shown
        store, is_final = shaped or store, bool(shaped)
    return anchored(session.open_field(store), *anchor_of(obj)), is_final


def _shaped_store(request) -> str:
    """Return the store of a request's mesh, "" if the mesh shows a preview of the stack, or without a request.

    Land that `waits` is used as shaped land, other land as a preview.
    """
    if request is None:
        return ""
    if request.land is None:
        return request.store
    return request.land.folder if request.land.waits else ""


def active_numbers(land) -> list[int]:
    """Return the positions in the list of the entries that are on and not masked out."""
    return [n for n, e in enumerate(land.entries) if e.on and (e.mask.kind == EVERYWHERE or e.mask.factor > 0.0)]


def state_of(obj) -> LandState:
    """Return the state of a terrain's land after its last update; LandState() if no entry of the stack is active.

    `seen` in it: the land is fine only where the views of a shot look, and the shot may have changed.

    A terrain of less than SMALL_M gets a note about its size instead of any other.
    """
    numbers = active_numbers(obj.adaptive_terrain.land)
    if not numbers:
        return LandState()
    state, found = _state_after_update(obj, numbers), imported_of(obj.adaptive_terrain)
    state = replace(state, seen=is_of_views(store_of(obj)))
    longer = max(found.extent_m) if found is not None else SMALL_M
    if longer < SMALL_M:  # such as the terrain of the Add menu
        note = phrase("Effects are in metres, and the terrain measures {}: set its Size", length_text(longer))
        state = replace(state, note=note)
    return state


def _state_after_update(obj, numbers: list[int]) -> LandState:
    """Return the LandState of the mesh of the last update: a preview, shaped land, or neither, with the reason.

    numbers: positions of the active entries in the list. The note warns of tiles that may not fit together, or else
    tells how much the levels that were left out may change heights.
    """
    request = session.record_of(obj).status.request
    if request is not None and request.land is not None and not request.land.waits:  # the mesh shows a preview
        preview = preview_of(request.land)
        if preview is not None:
            slow = phrase(preview.left_out_entry)
            note = phrase("{} takes too long for a preview: Shape Now", slow) if slow else phrase(NOTES[PREVIEW])
            ms = _by_number(numbers, preview.ms)
            return LandState(active=True, shown=PREVIEW, step_m=preview.step_m, ms=ms, note=note)
    shown = _shaped_store(request)
    info = _read_provenance(shown, stores.changed_ns(shown)) if shown else None
    if info is None:
        return LandState(active=True, note=_why_not_shown(obj))
    tiles, note = (sum(map(len, info.tiles)), sum(info.tile_counts)), ""  # built, all
    if info.doubtful:  # an effect whose tiles may not fit together
        note = phrase(DOUBTFUL, phrase(info.doubtful), f"{MAX_WHOLE:,}")
    elif info.left_out_max_m > 0.0:  # whole_effect: the one that computed all of a level, which others left out
        sizes = plain(info.left_out_rms_m), plain(info.left_out_max_m)
        note = (
            phrase(LEFT_OUT_BUT, phrase(info.whole_effect), *sizes) if info.whole_effect else phrase(LEFT_OUT, *sizes)
        )
    return LandState(
        active=True,
        shown=SHAPED,
        step_m=info.step_m,
        tiles=tiles,
        ms=_by_number(numbers, info.ms),
        note=note,
        finished_early=info.finished_early,
    )


def _by_number(numbers: list[int], ms) -> dict[int, float | None]:
    """Return milliseconds by the positions of the active entries; entries added since the update have none."""
    return dict(zip(numbers, ms, strict=False))


@dataclass(frozen=True)
class _ShapingInfo:
    """The provenance of a shaped store, as `Shaped` of height_operators/shape.py wrote it."""

    step_m: float  # metres between the samples of its finest level
    ms: tuple[float | None, ...]  # by active entry, None if all its tiles were reused
    tiles: list  # the built tiles of each level
    tile_counts: list  # number of all tiles of each level
    left_out_rms_m: float  # change of heights that levels which were not computed may make, in metres
    left_out_max_m: float
    finished_early: bool
    doubtful: str  # an effect whose tiles may not fit, or ""
    whole_effect: str  # an effect that computes whole levels though only some tiles were requested, or ""


@functools.lru_cache(maxsize=64)
def _read_provenance(store: str, _changed_ns: int) -> _ShapingInfo | None:
    """Read the provenance of a shaped store, None if it has none or an invalid one.

    Its list `added` has statistics of each effect at each level; `entry` is the effect's number among the active
    entries, `computed` its number of tiles that were not cached. `_changed_ns`: last change of the store's file, part
    of the cache's key.
    """
    try:
        shaped = stores.read_json(Path(store))["provenance"]["shaped"]
        ms: list[float | None] = [None] * (1 + max((added["entry"] for added in shaped["added"]), default=-1))
        for added in shaped["added"]:
            if added["computed"]:
                ms[added["entry"]] = (ms[added["entry"]] or 0.0) + added["ms"]
        step_m = min((added["spacing_m"] for added in shaped["added"]), default=0.0)
        partial = {level for level, tiles in enumerate(shaped["tiles"]) if len(tiles) < shaped["tile_counts"][level]}
        # Effects that computed a whole level though only some of its tiles were requested.
        whole = (_label_of(step["effect"]) for step in shaped["added"] if step["whole"] and step["level"] in partial)
        # The first effect whose tiles may not fit together.
        doubtful = next((_label_of(added["effect"]) for added in shaped["added"] if added.get("doubtful", False)), "")
        return _ShapingInfo(
            step_m=step_m,
            ms=tuple(ms),
            tiles=shaped["tiles"],
            tile_counts=shaped["tile_counts"],
            left_out_rms_m=shaped["left_out_rms_m"],
            left_out_max_m=shaped["left_out_most_m"],
            finished_early=shaped["finished_early"],
            doubtful=doubtful,
            whole_effect=next(whole, ""),
        )
    except (TerrainError, KeyError, IndexError, TypeError, AttributeError):  # a provenance may hold anything
        return None


def _label_of(effect: str) -> str:
    """Return the label of a height operator, or its name if this version does not have it."""
    return getattr(operator_of(effect), "label", effect)


def layers_left_by(land) -> list[LandLayer]:
    """Return the layers that the active entries leave in the shaped store, each once."""
    effects = [operator_of(land.entries[n].effect) for n in active_numbers(land)]
    return list({layer.name: layer for effect in effects if effect for layer in effect.layers}.values())
