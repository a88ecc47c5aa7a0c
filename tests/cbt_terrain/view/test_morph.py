# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that rise to their places: by the view alone, within the bound, without a jump."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH, mean_ramp
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from fields import mesh_heights, rough, scattered
from finer_fields import finer_field
from horizon_scenes import behind_a_ridge
from invariants import arrays
from morphs import mean_ratio, means_of_meshes, risen_points

POINTS = 120
RARE = "error", "outside", "far", "finer meshlets", "bicubic", "areas", "metres"  # cases for runs of everything
ROUNDS = max(12, int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) // 20)
SHARP = (4000, 3000)
AHEAD = View.look((0, -350, 125), (0, 0, 0), resolution=SHARP)
ASIDE = View.look((260, 150, 100), (0, 0, 0), fov_deg=30, resolution=(3000, 2000))
NEAR = View.look((0, -150, 40), (0, 0, 0), fov_deg=30, resolution=SHARP)
OVER_TILES = View.look((-500, -800, 350), (-250, -200, 0), resolution=SHARP)
TURNED = np.array([[0.8, -0.9, 0, 10], [0.6, 1.2, 0, 20], [0, 0, 2, 30], [0, 0, 0, 1.0]])


@pytest.mark.parametrize("k", [1.0, 1.25, 1.5, 2.0, 4.0])
def test_the_mean_of_the_ramp(k):
    assert mean_ramp(k) == pytest.approx(mean_ratio(k) if k > 1 else 1.0, rel=1e-6)


@pytest.fixture(scope="module")
def ground():
    return rough(33, 33, relief=30.0)


def cases() -> list:
    def case(name, criterion, views=(AHEAD,), field=None, **placed):
        marks = [pytest.mark.thorough] if name in RARE else []
        return pytest.param(field, Criterion(**criterion), views, placed, id=name, marks=marks)

    placed = {"placement": TURNED, "vertical_scale": -1.5, "vertical_offset": 7.0}
    tiled = interpolated(finer_field(33, 40, 4, ((0, 0),), relief=20.0), "bicubic")
    detailed = with_detail(rough(9, 9, relief=10.0), Detail(amplitude=1.0, wavelength=16.0))
    return [
        case("error", {"error_px": 12, "morph": 1.5}),
        case("far", {"error_px": 16, "morph": 4}),
        case("meshlets", {"error_px": 8, "morph": 2, "meshlet": 1}),
        case("finer meshlets", {"error_px": 12, "morph": 2, "meshlet": 2}),
        case("bicubic", {"error_px": 16, "morph": 2}, field=interpolated(rough(17, 17, relief=30.0), "bicubic")),
        case("bicubic tiles", {"error_px": 16, "morph": 2}, (OVER_TILES,), field=tiled),
        case("two views", {"error_px": 16, "morph": 1.5}, (AHEAD, ASIDE)),
        case("edges", {"error_px": 24, "edge_px": 400, "morph": 1.5}),
        case("areas", {"error_px": 0, "area_px": 60000, "morph": 2}, (ASIDE,)),
        case("metres", {"error_px": 24, "error_m": 1, "morph": 1.5}),
        case("outside", {"error_px": 12, "morph": 1.5, "guard_deg": 0}, (NEAR,)),
        case("padded, placed", {"error_px": 16, "morph": 1.5}, field=rough(25, 19, relief=30.0), **placed),
        case("detail", {"error_px": 12, "morph": 2, "max_depth": 13}, field=detailed),
    ]


@pytest.mark.parametrize(("field", "criterion", "views", "placed"), cases())
def test_a_point_is_at_the_mean_of_the_meshes(ground, field, criterion, views, placed):
    """Of 8 and of 24: the difference falls as theirs to the integral, and is far below what points have to rise."""
    terrain = Terrain(field or ground, 1)
    surface = terrain.update(criterion, views, **placed).surface
    positions = np.random.default_rng(0).permutation(surface.positions)[:POINTS].astype(np.float64)
    tree, how = terrain.saved()
    in_place = {p[:2].tobytes(): p[2] for p in terrain.restore(tree, **how).surface.positions}
    rise = max(abs(in_place[p[:2].astype(np.float32).tobytes()] - p[2]) for p in positions)
    few, many = (
        np.abs(mean - positions[:, 2])
        for mean in means_of_meshes(terrain.field, criterion, views, positions[:, :2], 8, **placed)
    )
    assert rise > 0.02 and few.max() < 0.3 * rise and many.max() < 0.1 * rise and many.mean() < 0.5 * few.mean()


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["PERSPECTIVE", ORTHOGRAPHIC, PANORAMIC])
def test_a_point_rises_and_turns_by_its_own_ratio(kind):
    """Compare every vertex with a recursion over all triangles of a small field: heights to a tenth of a millimetre,
    normals to a millionth."""
    field = rough(33, 17, seed=4, relief=40.0)
    view = View.look((30, -200, 90), (0, 0, 0), kind=kind, fov_deg=50, resolution=(900, 700), ortho_width=300.0)
    criterion = Criterion(error_px=5.0, morph=2.0, off_screen_factor=1.0, max_depth=field.lattice.cell_depth)
    terrain = Terrain(field, 1)
    update = terrain.update(criterion, [view])
    expected, normals = risen_points(field, view, 5.0, 2.0, terrain._placed[1].rounding)
    places = np.rint(update.surface.positions[:, :2] / 10.0 + (8.0, 16.0)).astype(int)
    z = np.array([expected[tuple(place)] for place in places.tolist()])
    assert np.abs(update.surface.positions[:, 2] - z).max() < 1e-4
    assert np.abs(field.samples[places[:, 1], places[:, 0]] - z).max() > 0.5
    turned = np.array([normals[tuple(sample)] for sample in places.tolist()])
    assert np.abs(update.surface.normals - turned).max() < 1e-6
    still = Terrain(field, 1).restore(*terrain.saved()[:1], **terrain.saved()[1]).surface
    assert np.abs(still.normals - turned).max() > 0.1


def test_points_that_rise_at_once_are_those_of_the_plain_mesh():
    field, view = rough(65, 65), View.look((0, -500, 200), (0, 0, 0))
    for criterion in ({"error_px": 2.0}, {"error_px": 4.0, "meshlet": 1}, {"error_px": 0.0, "error_m": 1.0}):
        plain, risen = (
            Terrain(field, 1).update(Criterion(**criterion, off_screen_factor=1.0, morph=k), [view])
            for k in (1.0, 1.0 + 1e-12)
        )
        assert arrays(plain.surface) == arrays(risen.surface)
    field = rough(65, 65)
    metres = Criterion(error_px=0.0, error_m=1.0)
    assert arrays(Terrain(field, 1).update(metres).surface) == arrays(
        Terrain(field, 1).update(Criterion(error_px=0.0, error_m=1.0, morph=2.0)).surface
    ), "without a view nothing moves"


def a_flight(rng):
    """Return a field, a criterion, and views that move a little each frame."""
    field = rough(*((129, 65), (65, 65), (90, 50))[rng.integers(3)], int(rng.integers(99)), relief=60.0)
    if rng.random() < 0.3:
        field = interpolated(field, "bicubic")
    if rng.random() < 0.3:
        field = with_detail(field, Detail(amplitude=1.0, wavelength=8.0))
    criterion = Criterion(
        error_px=float(rng.choice([4.0, 8.0])),
        edge_px=float(rng.choice([0.0, 0.0, 60.0])),
        error_m=float(rng.choice([0.0, 0.0, 3.0])),
        max_triangles=(None, None, 800)[rng.integers(3)],
        hidden_factor=float(rng.choice([1.0, 8.0])),
        meshlet=int(rng.choice([0, 0, 1])),
        morph=float(rng.choice([1.25, SMOOTH, 2.0, 4.0])),
    )
    eye, step = rng.uniform(-400, 400, 3) + [0, 0, 450], rng.normal(size=3) * 10.0 ** rng.uniform(-2, 1)
    return field, criterion, [View.look(eye + step * frame, (0, 0, 0), resolution=(960, 540)) for frame in range(4)]


@pytest.mark.thorough
def test_any_frame_alone_is_the_same_frame_in_a_flight(eager_threads):
    """12 random flights, from one to three threads: the bytes, the bounds; and after a frame without a morph."""
    for seed in range(ROUNDS):
        rng = np.random.default_rng(seed)
        field, criterion, views = a_flight(rng)
        flown = Terrain(field, int(rng.integers(1, 4)))
        for frame, view in enumerate(views):
            if frame == 3:
                flown.update(Criterion(error_px=criterion.error_px, meshlet=criterion.meshlet), [views[0]])
            found, alone = flown.update(criterion, [view]), Terrain(field, 1).update(criterion, [view])
            assert arrays(found.surface) == arrays(alone.surface), (seed, frame)
            assert found.bound_px == alone.bound_px and found.relaxed == alone.relaxed
    # The same triangles under a view that has moved a little are another mesh, and without a morph another one again.
    view = View.look((0, -500, 200), (0, 0, 0))
    moved = View.look((0, -499.9999, 200), (0, 0, 0))
    flown = Terrain(rough(65, 65), 1)
    first = flown.update(Criterion(error_px=4.0, morph=2.0), [view]).surface.copy()
    update = flown.update(Criterion(error_px=4.0, morph=2.0), [moved])
    assert update.changed and (update.surface.triangles == first.triangles).all()
    assert 0 < np.abs(update.surface.positions - first.positions).max() < 1e-3


def test_a_saved_tree_has_its_points_in_their_places():
    field, view = rough(65, 65), View.look((0, -500, 200), (0, 0, 0))
    terrain = Terrain(field, 1)
    risen = terrain.update(Criterion(error_px=4.0, morph=1.5), [view]).surface.copy()
    tree, how = terrain.saved()
    again = Terrain(field, 1).restore(tree, **how)
    assert how["morph"] == 1.5 and (again.surface.triangles == risen.triangles).all()
    assert (again.surface.positions[:, :2] == risen.positions[:, :2]).all()
    assert measure(field, again.surface, random_points=1).vertical_max_m <= again.bound_m
    after = terrain.update(Criterion(error_px=4.0, morph=1.5), [View.look((0, -501, 200), (0, 0, 0))])
    assert arrays(after.surface) == arrays(
        Terrain(field, 1).update(Criterion(error_px=4.0, morph=1.5), [View.look((0, -501, 200), (0, 0, 0))]).surface
    )


def test_metres_hold_if_the_source_has_rounded_half_of_them():
    """For a bound in metres beside one on screen; and what float32 takes is in both."""
    field, ahead = rough(33, 33, relief=60.0), View.look((0, -350, 125), (0, 0, 0), resolution=(640, 480))
    for part in (0.0, 0.1, 0.2, 0.3, 0.5):
        rounded = from_array(field.samples, 10.0, source_max=part)
        update = Terrain(rounded, 1).update(Criterion(error_px=1e4, error_m=1.0, morph=2.0), [ahead])
        assert update.bound_m == 1.0 and update.limited == "" and update.terms_m.source == pytest.approx(part)
        assert 0.2 < measure(rounded, update.surface, random_points=1).vertical_max_m <= 1.0 - part
    off = Terrain(from_array(field.samples + 1e6, 10.0), 1)
    update = off.update(Criterion(error_px=1.0, error_m=0.05, morph=2.0, max_depth=26), [ahead])
    assert update.limited == "precision" and update.bound_m > 0.05
    measured = measure(off.field, update.surface, ahead, random_points=1)
    assert measured.vertical_max_m <= update.bound_m and measured.screen_px.max <= update.bound_px


def test_a_triangle_limit_does_not_jump_where_its_step_changes():
    """Each frame is relaxed by a little more than the last, across three steps of a thirty-second of an octave."""
    field = rough(65, 65, relief=60.0)
    terrain, plane, last, factors, moves = Terrain(field, 1), scattered(field, 400), None, [], []
    criterion = Criterion(error_px=2.0, off_screen_factor=1.0, max_triangles=1500, morph=SMOOTH)
    for frame in range(24):
        view = View.look((0, -700 + 2.0 * frame, 250), (0, 0, 0), resolution=(960, 540))
        update = terrain.update(criterion, [view])
        assert update.triangles <= 1500 and update.limited
        z = mesh_heights(update.surface, plane)
        moves += [] if last is None else [np.abs(z - last).max()]
        factors.append(32 * np.log2(update.relaxed))
        last = z
    changes = np.diff(np.floor(factors)) != 0
    assert changes.sum() > 0 and np.abs(np.diff(factors)).max() < 0.5
    assert np.array(moves)[changes].max() < 2 * np.array(moves)[~changes].max() < 1.0


def test_a_limit_just_out_of_reach_takes_effect_gradually():
    """As the limit falls from enough triangles to too few, the factor grows from 1 without a jump."""
    field, view = rough(65, 65, relief=60.0), View.look((0, -700, 250), (0, 0, 0), resolution=(960, 540))
    full = Terrain(field, 1).update(Criterion(error_px=4.0, morph=SMOOTH), [view]).triangles
    budgets = np.linspace(1.2 * full, 0.9 * full, 16).astype(int)
    found = [
        Terrain(field, 1).update(Criterion(error_px=4.0, morph=SMOOTH, max_triangles=int(n)), [view]).relaxed
        for n in budgets
    ]
    assert found[0] == 1.0 and found[-1] > 1.05 and 0.0 <= np.diff(found).min() and np.diff(found).max() < 0.03


def test_what_leaves_the_frame_gets_coarser_by_degrees():
    """A camera that only turns: the ground outside of its frame moves by less, the less it turns, down to a step of a
    fiftieth of a degree; without a morph it does not."""
    field, most = rough(65, 65, relief=60.0), []
    plane = scattered(field, 400)
    for step in (0.32, 0.08, 0.02):
        terrain, heights = Terrain(field, 1), []
        for turn in np.radians(20 + step * np.arange(5)):
            target = (300 * np.sin(turn), -400 + 300 * np.cos(turn), 110)
            view = View.look((0, -400, 180), target, resolution=(960, 540))
            heights.append(mesh_heights(terrain.update(Criterion(error_px=4.0, morph=SMOOTH), [view]).surface, plane))
        most.append(np.abs(np.diff(heights, axis=0)).max())
    assert most[0] > 3 * most[1] > 9 * most[2] > 0


def test_what_nearer_ground_hides_gets_coarser_by_degrees():
    """A camera that rises behind a ridge: the ground that comes into its sight moves by less, the less it rises."""
    z, _ = behind_a_ridge(129)
    field, most = from_array(z, 8.0), []
    plane = scattered(field, 600)
    for step in (1.6, 0.4, 0.1):
        terrain, heights = Terrain(field, 1), []
        for rise in 100 + step * np.arange(5):
            view = View.look((0, -8.0 * 64, rise), (0, 0, 60.0), resolution=(960, 540))
            criterion = Criterion(error_px=4.0, morph=SMOOTH, hidden_factor=16.0, off_screen_factor=1.0)
            heights.append(mesh_heights(terrain.update(criterion, [view]).surface, plane))
        most.append(np.abs(np.diff(heights, axis=0)).max())
    assert most[0] > 3 * most[1] > 9 * most[2] > 0, most


@pytest.mark.parametrize("wrong", [0.5, -1.0, 4.5, float("nan"), float("inf")])
def test_what_is_no_morph_is_refused(wrong):
    with pytest.raises(TerrainError, match=r"The criterion's morph is .*; expected a number from 1 to 4\."):
        Criterion(morph=wrong)
