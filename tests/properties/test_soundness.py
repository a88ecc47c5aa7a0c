# SPDX-License-Identifier: GPL-3.0-or-later
"""For any field, view and request the mesh is sound and keeps its bound."""

from hypothesis import given
from hypothesis import strategies as st
from scenarios import assert_sound
from strategies import criteria, fields, scenarios, views


@given(scenarios())
def test_any_scene_is_sound(scenario):
    assert_sound(scenario)


@given(scenarios(views=st.lists(views(("ORTHOGRAPHIC",)), min_size=1, max_size=1)))
def test_orthographic_scenes_are_sound(scenario):
    assert_sound(scenario)


@given(scenarios(views=st.lists(views(("PANORAMIC",)), min_size=1, max_size=1)))
def test_panoramic_scenes_are_sound(scenario):
    assert_sound(scenario)


@given(scenarios(field=fields(shapes=[(2, 2), (3, 3), (5, 9), (9, 9)]), criterion=criteria(meshlets=(3, 4))))
def test_large_meshlets_are_sound(scenario):
    assert_sound(scenario)


@given(
    scenarios(field=fields(shapes=[(6, 7), (20, 31), (2, 40), (13, 13)]), criterion=criteria(meshlets=(0, 1))),
)
def test_fields_that_are_not_on_a_lattice_are_sound(scenario):
    assert_sound(scenario)


@given(scenarios(field=fields(interpolations=("bicubic",))))
def test_bicubic_scenes_are_sound(scenario):
    assert_sound(scenario)


@given(
    scenarios(
        field=fields(shapes=[(2, 2), (3, 3), (5, 9), (6, 7), (13, 13)], interpolations=("bicubic",)),
        criterion=criteria(meshlets=(1, 2, 3, 4)),
    )
)
def test_bicubic_meshlets_are_sound_on_padded_rasters(scenario):
    assert_sound(scenario)


MORPHING = st.tuples(criteria(), st.sampled_from([1.25, 1.5, 4.0])).map(lambda drawn: drawn[0] | {"morph": drawn[1]})


@given(scenarios(criterion=MORPHING))
def test_scenes_with_geomorph_are_sound(scenario):
    assert_sound(scenario)
