# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation gives the same bytes with any history, and computes only unknown attributes that something reads."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import jet
from adaptive_terrain.cbt_terrain.attributes.attribute import GEOMETRY, PICTURE, AttributeDeclaration, AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.plan import AttributePlan, plan
from adaptive_terrain.cbt_terrain.attributes.splat import SPLATS
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, View
from evaluations import Evaluations
from padded import raster

EVERY = plan([AttributeRequest(name, ("a material",)) for name in jet.OUTPUTS])


def field():
    return from_array(raster(200, 130), 10.0)


def view(rng) -> View:
    eye = rng.uniform(-900, 900, 3) + [0, 0, 1000]
    kind = ("PERSPECTIVE", "PERSPECTIVE", PANORAMIC, ORTHOGRAPHIC)[rng.integers(4)]
    return View.look(eye, (0, 0, 0), kind=kind, resolution=(60, 40), ortho_width=3000.0)


def bytes_of(found) -> dict[str, bytes]:
    return {name: attribute.array.tobytes() for name, attribute in found.items()}


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (1, 2, 3))])
def test_any_history_gives_the_bytes_of_none(seed, monkeypatch):
    """Views that creep, jump and take turns, plans and families that change, an object that is turned and scaled."""
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.run.launch.SLICE_ITEMS", 50)
    rng, heights = np.random.default_rng(seed), field()
    terrain, kept = Terrain(heights, 2), Evaluations(threads=2)
    now, known = view(rng), 0
    for frame in range(20):
        if rng.random() < 0.15:
            now = view(rng)
        matrix = now.world_to_camera.copy()
        matrix[:3, 3] += rng.normal(0, 2, 3)
        now = View(matrix, now.projection, now.resolution, now.kind, now.clip, now.radians_per_pixel)
        views = [now] if rng.random() < 0.9 else [now, view(rng)]
        if frame == 0 or rng.random() < 0.4:
            names = rng.permutation(list(jet.OUTPUTS))[: rng.integers(1, 8)]
            families = [PICTURE if rng.random() < 0.7 else GEOMETRY for _ in names]
            wanted = plan(
                [AttributeRequest(name, ("x",), family) for name, family in zip(names, families, strict=True)]
            )
        placement = np.diag([1.0, 2.0, 0.5, 1.0]) if rng.random() < 0.1 else None
        scale = {"vertical_scale": 2.0, "vertical_offset": 3.0} if rng.random() < 0.1 else {}
        surface = terrain.update(Criterion(error_px=0.1), views, placement, **scale).surface
        asked = (wanted, heights, surface, views, placement)
        metres = 40.0 if rng.random() < 0.1 else 0.0
        found = kept.attributes(*asked, **scale, geometry_metres=metres)
        assert bytes_of(found) == bytes_of(Evaluations().attributes(*asked, **scale, geometry_metres=metres))
        assert found.keys() == set(names) and all(len(found[name].array) == len(surface.positions) for name in names)
        known += sum(ran.computed < len(surface.positions) for ran in kept.ran.values())
    assert known > 10, "next to nothing was kept, so next to nothing was tested"


def flown(evaluator: Evaluations, heights, terrain: Terrain, x: float, wanted: AttributePlan = EVERY):
    views = [View.look((x, -900.0, 500.0), (0, 0, 0), resolution=(60, 40))]
    surface = terrain.update(Criterion(error_px=0.05), views).surface
    return evaluator.attributes(wanted, heights, surface, views), surface, views


def test_a_small_step_computes_little():
    heights, evaluator = field(), Evaluations()
    terrain = Terrain(heights)
    _, surface, views = flown(evaluator, heights, terrain, 0.0)
    assert all(ran.computed == len(surface.positions) for ran in evaluator.ran.values())
    assert set(evaluator.runs.values()) == {1}
    found, surface, views = flown(evaluator, heights, terrain, 0.5)
    assert all(0 < ran.computed < 0.1 * len(surface.positions) for ran in evaluator.ran.values())
    again = evaluator.attributes(EVERY, heights, surface, list(views))
    assert set(evaluator.runs.values()) == {2} and evaluator.ran["slope"].computed == 0
    assert all(again[name] is found[name] for name in found)
    copied = surface.copy()  # the same places in other memory
    assert bytes_of(evaluator.attributes(EVERY, heights, copied, views)) == bytes_of(found)
    assert set(evaluator.runs.values()) == {2} and evaluator.ran["slope"].computed == 0


def test_unused_effects_are_not_computed_and_calls_are_shared(monkeypatch):
    calls = []

    def counted(places, wanted, read):
        calls.append(sorted(wanted))
        return jet.make(places, wanted, read)

    for name in jet.OUTPUTS:
        effect = ATTRIBUTES[name]
        values = {key: getattr(effect, key) for key in AttributeDeclaration.__dataclass_fields__}
        monkeypatch.setitem(ATTRIBUTES, name, AttributeDeclaration(**(values | {"make": counted})))
    heights, evaluator = field(), Evaluations()
    terrain = Terrain(heights)
    some = plan(
        [
            AttributeRequest("slope", ("x",)),
            AttributeRequest("height", ("y",)),
            AttributeRequest("moisture", ("an attribute of others",)),
        ]
    )
    flown(evaluator, heights, terrain, 0.0, some)
    assert calls == [["height", "slope"]] and set(evaluator.runs) == {"slope", "height"}
    more = plan(
        [AttributeRequest("slope", ("x",)), AttributeRequest("height", ("y",)), AttributeRequest("aspect", ("z",))]
    )
    flown(evaluator, heights, terrain, 0.0, more)
    assert calls[1:] == [["aspect"]], "what was known stays"
    found, _, _ = flown(evaluator, heights, terrain, 0.0, AttributePlan())
    assert found == {} and len(calls) == 2


def test_splats_without_layers_are_zeros_without_a_call():
    """Whatever layers came before, and at every step of a flight."""
    heights, evaluator = field(), Evaluations(threads=2)
    terrain = Terrain(heights)
    names = [splat.name for splat in SPLATS]
    for frame, count in enumerate((3, 3, 5, 5, 4, 3, 12, 1, 9)):
        layers = tuple(Layer(str(k), strength=1.0 + k) for k in range(count))
        wanted = plan([AttributeRequest(name, ("x",), parameters=(("layers", layers),)) for name in names])
        found, surface, _ = flown(evaluator, heights, terrain, 0.5 * frame, wanted)
        weights = np.concatenate([found[name].array for name in names], axis=1)
        assert weights.shape == (len(surface.positions), 12) and (weights[:, :count] > 0).all()
        assert (weights[:, count:] == 0).all() and (weights.sum(axis=1) == 1).all()
        unmade = {name for k, name in enumerate(names) if 4 * k >= count}
        assert {name for name in names if evaluator.ran[name].computed == 0} == unmade
        assert {name for name in names if evaluator.ran[name].nbytes == 0} == unmade


def test_for_geometry_no_value_depends_on_the_camera():
    heights, evaluator = field(), Evaluations()
    wanted = plan([AttributeRequest("slope", ("a modifier",), GEOMETRY)])
    terrain = Terrain(heights)
    surface = terrain.update(Criterion(error_px=1.0), [View.look((0, -900.0, 500.0), (0, 0, 0))]).surface
    far, near = (View.look((0, -y, 500.0), (0, 0, 0)) for y in (90_000.0, 900.0))
    for metres in (0.0, 80.0):
        one, other = (
            evaluator.attributes(wanted, heights, surface, [v], geometry_metres=metres)["slope"].array.copy()
            for v in (far, near)
        )
        assert one.tobytes() == other.tobytes()
    fine = evaluator.attributes(wanted, heights, surface, [far])["slope"].array
    assert (fine != one).any()


def test_results_stay_until_the_next_call_or_failure(monkeypatch):
    heights, evaluator = field(), Evaluations()
    terrain = Terrain(heights)
    flown(evaluator, heights, terrain, 0.0)
    found, _, _ = flown(evaluator, heights, terrain, 1.0)
    before = bytes_of(found)
    with monkeypatch.context() as broken:
        broken.setattr(jet.launch, "spread", lambda *_args, **_more: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            flown(evaluator, heights, terrain, 2.0)
    assert bytes_of(found) == before
    found, surface, views = flown(evaluator, heights, terrain, 2.0)
    assert bytes_of(found) == bytes_of(Evaluations().attributes(EVERY, heights, surface, views))


def test_another_field_of_the_same_places_takes_over_nothing():
    one, other = from_array(np.zeros((33, 33), np.float32), 10.0), from_array(np.eye(33, dtype=np.float32) * 0, 10.0)
    other = other.with_raster(samples=other.samples + np.arange(33, dtype=np.float32), digest="another")
    surface = Terrain(one).update(Criterion(error_px=0, error_m=1.0)).surface
    evaluator = Evaluations()
    assert not evaluator.attributes(EVERY, one, surface)["slope"].array.any()
    assert (evaluator.attributes(EVERY, other, surface)["slope"].array > 0.09).all()


def test_values_are_held_once():
    """They move inside their arrays from frame to frame, with the bytes of a new evaluation."""
    heights, eye = field(), np.array([-900.0, -700.0, 600.0])
    names = ("slope", "aspect", "detail_normal", "sun", "sky")
    wanted = plan([AttributeRequest(name, ("x",)) for name in names])
    terrain, evaluator, most = Terrain(heights, 2), Evaluations(threads=2), 0
    for step in (0, 1, 2, 3, 2, 40, 41):
        views = [View.look(eye + [step, 0, 0], (0, 0, 0), resolution=(60, 40))]
        surface = terrain.update(Criterion(error_px=0.1), views).surface
        found = evaluator.attributes(wanted, heights, surface, views)
        assert bytes_of(found) == bytes_of(Evaluations().attributes(wanted, heights, surface, views))
        assert step == 40 or not step or 0 < evaluator.ran["sky"].computed < len(surface.positions)
        most = max(most, len(surface.positions))
        width = sum(item.array.size for item in found.values()) / len(surface.positions)
        assert evaluator.nbytes <= 1.25 * 4 * most * (width + 2), "all values once, levels twice"
