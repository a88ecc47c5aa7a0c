# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors with fields."""

import pickle

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError

FIELDS = {
    "what": "The saved tree has version 3",
    "expected": "version 2",
    "fix": "save it again",
    "code": "tree.version",
}


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        (FIELDS, "The saved tree has version 3; expected version 2: save it again."),
        ({"what": "It is empty", "where": "/a/b.store"}, "It is empty (/a/b.store)."),
        ({"what": "It is empty", "where": "/a/b.store", "fix": "import it"}, "It is empty (/a/b.store): import it."),
        ({"what": "It is empty."}, "It is empty."),
    ],
)
def test_fields_become_one_sentence(fields, sentence):
    assert str(TerrainError(**fields)) == sentence


def test_an_error_within_another_keeps_its_fields():
    error = TerrainError(**FIELDS).within("The mesh cannot be made")
    assert str(error) == f"The mesh cannot be made. {TerrainError(**FIELDS)}"
    assert error.to_json() == {
        "what": "The mesh cannot be made. The saved tree has version 3",
        "expected": "version 2",
        "fix": "save it again",
    }


def test_fields_survive_json_and_pickle():
    error = TerrainError(**FIELDS)
    assert error.to_json() == FIELDS
    assert pickle.loads(pickle.dumps(error)).to_json() == FIELDS
