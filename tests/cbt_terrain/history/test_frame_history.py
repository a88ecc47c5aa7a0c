# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame history only saves time: real, empty and discarded half-way, it gives the same bytes."""

import os
import sys
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain import cbt_terrain
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.scatter.points import ScatterRequest, place_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from fields import extent, rough
from invariants import arrays

FLIGHTS = max(6, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 20)
FRAMES = 6
ENGINE = str(Path(cbt_terrain.__file__).parent)
# Where a second exception would have to come to be harmful: threads that still run, and the lock.
NOT_INTERRUPTED = {"launch.py", "locks.py"}, {"alone", "discard", "writing"}
ATTRIBUTES = plan([AttributeRequest(name, ("a test",)) for name in ("slope", "height", "detail_normal")])


@dataclass
class Engine:
    """A terrain with a scatter on it, and their histories."""

    terrain: Terrain
    scatter: Scatter
    history: FrameHistory = field(default_factory=FrameHistory)

    def frame(self, views, saved=None, **asked) -> dict:
        """Return everything that a frame makes, as bytes and numbers."""
        terrain = self.terrain
        if saved is None:
            update = terrain.update(asked["criterion"], views, asked["placement"], *asked["scale"])
        else:
            tree, how = saved
            update = terrain.restore(tree, **how)
        self.surface = update.surface
        heights = dict(zip(("vertical_scale", "vertical_offset"), asked["scale"], strict=True))
        request = EffectRequest(ATTRIBUTES, update.surface, views, asked["placement"], **heights)
        values = evaluate(terrain.field, request, terrain.history, terrain.threads)
        scattered = ScatterRequest(self.scatter, views, asked["placement"], **heights)
        points = place_points(terrain.field, scattered, self.history, terrain.threads)
        found = {name: getattr(update, name) for name in ("leaves", "relaxed", "limited", "terms_px", "terms_m")}
        found |= {name: getattr(update, f"bound_{name}") for name in ("px", "m", "edge_px", "area_px")}
        found |= {"mesh": arrays(update.surface), "tree": terrain.saved()}
        found |= {name: attribute.array.tobytes() for name, attribute in values.attributes.items()}
        return found | {"points": [a.tobytes() for a in (points.positions, points.size, points.id, points.rotation)]}


def a_field(rng):
    """Padded or not, with holes or without, bilinear or bicubic."""
    height, width = ((65, 65), (33, 97), (50, 70), (60, 41))[rng.integers(4)]
    heights = np.array(rough(height, width, int(rng.integers(1 << 30)), relief=float(rng.choice([5.0, 60.0]))).samples)
    heights = heights[:height, :width]
    holes = rng.random() < 0.3
    if holes:
        heights[10:16, 20:29] = np.nan
    return interpolated(from_array(heights, 10.0, holes=holes), INTERPOLATIONS[rng.integers(2)])


def a_criterion(rng) -> Criterion:
    px = float(rng.choice([0.7, 2.0, 5.0]))
    asked = [{}, {}, {"error_px": 0.0, "edge_px": 10 * px}, {"error_m": 1.0}]
    return Criterion(
        **{"error_px": px} | asked[rng.integers(4)],
        max_triangles=[None, None, 400, 3000][rng.integers(4)],
        meshlet=int(rng.choice([0, 0, 1, 2])),
        morph=float(rng.choice([1.0, SMOOTH])),
        hidden_factor=float(rng.choice([1.0, 1.0, 8.0])),
        max_depth=[None, 13, 16][rng.integers(3)],
    )


def a_flight(rng, ground):
    """Yield views that creep, stand still and jump, one or two at a time."""
    size = extent(ground)
    kind = (PERSPECTIVE, PERSPECTIVE, PERSPECTIVE, ORTHOGRAPHIC, PANORAMIC)[rng.integers(5)]
    eye = rng.uniform(-0.5, 0.5, 3) * size + [0, 0, 0.2 * size[0]]
    other = View.look(-eye, (0, 0, 0), resolution=(320, 180), clip=(0.1, 1e5))
    two = rng.random() < 0.2
    for _ in range(FRAMES):
        step = rng.random()
        eye = eye + (0.0 if step < 0.15 else 0.2 if step > 0.9 else 1e-3) * rng.normal(size=3) * size
        wide = {"fov_deg": 360.0} if kind == PANORAMIC else {"ortho_width": float(size[0])}
        view = View.look(eye, (0.1, 0.0, 0.0), resolution=(320, 180), kind=kind, clip=(0.1, 1e5), **wide)
        yield [view, other] if two else [view]


@contextmanager
def interrupted_at_launch(monkeypatch, number: int):
    """Raise KeyboardInterrupt before launch number `number`; yields a list of the launches that there were."""
    launches = []

    def check():
        launches.append(1)
        if len(launches) > number:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(launch.stopping, "check", check)
        yield launches


@contextmanager
def interrupted_at_line(number: int):
    """Raise KeyboardInterrupt at line number `number` that Python runs in the engine."""
    lines, before = 0, sys.gettrace()
    files, functions = NOT_INTERRUPTED

    def trace(frame, event, _value):
        nonlocal lines
        code = frame.f_code
        inside = code.co_filename.startswith(ENGINE) and Path(code.co_filename).name not in files
        if event == "line" and inside and code.co_name not in functions:
            lines += 1
            if lines > number:
                sys.settrace(before)
                raise KeyboardInterrupt
        return trace if inside or event == "call" else None

    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(2, FLIGHTS))]
)
def test_any_history_gives_the_bytes_of_none(seed, monkeypatch, eager_threads):
    """A real history, an empty one, and one that an interrupt discarded half-way: meshes, trees, bounds, values of
    effects and scattered points, from one, two or three threads."""
    rng = np.random.default_rng(seed)
    ground, criterion = a_field(rng), a_criterion(rng)
    scatter = Scatter(spacing=9.0, full_until=200.0, where=Layer("Flat", (Rule("slope", low=0.0, high=0.8),)))
    placement = np.diag([1.0, 1.2, 0.8, 1.0]) if rng.random() < 0.2 else np.eye(4)
    scale = [(1.0, 0.0), (-2.0, 30.0)][int(rng.random() < 0.2)]
    flown, broken = (Engine(Terrain(ground, int(rng.integers(1, 4))), scatter) for _ in range(2))
    launches, saved = 20, None
    for views in a_flight(rng, ground):
        if rng.random() < 0.3:  # nothing of the last frame fits another criterion or placement
            change = [{"error_px": criterion.error_px * 1.2}, {"meshlet": 2}, {"morph": SMOOTH}, {"max_depth": 12}, {}]
            criterion = replace(criterion, **change[rng.integers(5)])
            scale = scale if rng.random() < 0.7 else (1.5, -10.0)
        asked = {"criterion": criterion, "placement": placement, "scale": scale}
        asked["saved"] = saved if rng.random() < 0.15 else None
        empty = Engine(Terrain(ground, 1), scatter)
        expected = empty.frame(views, **asked)
        assert flown.frame(views, **asked) == expected
        last = getattr(broken, "surface", None)
        before = last and arrays(last)
        try:
            if rng.random() < 0.5:
                with interrupted_at_launch(monkeypatch, int(rng.integers(0, launches))) as counted:
                    broken.frame(views, **asked)
                launches = len(counted) + 1
            else:
                with interrupted_at_line(int(10 ** rng.uniform(1.5, 3.5))):
                    broken.frame(views, **asked)
        except KeyboardInterrupt:
            pass
        assert last is None or arrays(last) == before, "an interrupt has changed the last surface"
        assert broken.frame(views, **asked) == expected
        saved = flown.terrain.saved() if criterion.morph == 1.0 else None


def test_an_interrupted_update_is_forgotten(monkeypatch):
    """It leaves no mesh to be asked about, and nothing that the next update might take for its own."""
    ground = rough(65, 65, relief=30.0)
    terrain = Terrain(ground, 1)
    views = [[View.look((x, -200.0, 90.0), (0, 0, 0), resolution=(320, 180))] for x in (0.0, 0.1, 0.2)]
    criterion = Criterion(error_px=1.0)
    first = terrain.update(criterion, views[0])
    before = arrays(first.surface)
    with interrupted_at_launch(monkeypatch, 1) as launches, pytest.raises(KeyboardInterrupt):
        terrain.update(criterion, views[1])
    assert len(launches) == 2
    history = terrain.history
    assert history.tree is None and history.last.key is None and history.last.vertices is None
    with pytest.raises(TerrainError, match="has no mesh yet"):
        terrain.triangles_at([(0.0, 0.0)])
    assert arrays(first.surface) == before
    assert terrain.update(criterion, views[0]).changed


def test_a_request_that_is_refused_leaves_the_last_frame():
    ground = rough(33, 33)
    terrain, view = Terrain(ground, 1), [View.look((0.0, -200.0, 90.0), (0, 0, 0))]
    update = terrain.update(Criterion(error_px=1.0), view)
    for wrong in ({"placement": np.zeros((4, 4))}, {"vertical_scale": 1e38}):
        with pytest.raises(TerrainError):
            terrain.update(Criterion(error_px=1.0), view, **wrong)
    again = terrain.update(Criterion(error_px=1.0), view)
    assert not again.changed and again.surface is update.surface


def test_an_unchanged_frame_keeps_vertices_for_the_next(eager_threads):
    """Of a mesh that did not change, the next frame still copies vertices."""
    terrain, criterion = Terrain(rough(65, 65, relief=30.0), 2), Criterion(error_px=0.3)
    for x in (0.0, 1e-6, 2e-6):
        unchanged = terrain.update(criterion, [View.look((x, -200.0, 90.0), (0, 0, 0), resolution=(320, 180))])
    assert not unchanged.changed and terrain.history.last.vertices is not None
    terrain.history.last.arrays.numpy("positions")[:, 2] += 1000.0
    moved = terrain.update(criterion, [View.look((0.5, -200.0, 90.0), (0, 0, 0), resolution=(320, 180))])
    assert moved.changed and 0.1 < (moved.surface.positions[:, 2] > 500.0).mean() < 1.0
