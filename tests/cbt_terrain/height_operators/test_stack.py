# SPDX-License-Identifier: GPL-3.0-or-later
"""Stacks as JSON: writing and reading preserves them, and invalid content gives one sentence."""

import json
import os

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.stack import (
    Entry,
    Stack,
    read_stack,
    stack_content,
    stack_from,
    write_stack,
)
from hypothesis import given
from hypothesis import strategies as st

RULES = (GroundRule("height", 600.0, edge=50.0), GroundRule("aspect", -0.5, 1.0, 0.25, 90.0))
STACK = Stack(
    (
        Entry("hill", {"height": 7.5}, seed=3, name="A mound"),
        Entry("smooth", on=False, mask=HeightMask("masks/valley.png", RULES, 0.75)),
    )
)


def test_an_earlier_name_of_an_effect_is_the_same_stack():
    """The key is that of land that was shaped under the earlier name, so that it is found again."""
    old = stack_from({"version": 1, "entries": [{"effect": "thermal", "parameters": {"depth": 8}, "seed": 1}]})
    assert old == Stack((Entry("scree", {"depth": 8.0}, 1),)) and stack_content(old)["entries"][0]["effect"] == "scree"
    assert Stack((*old.entries, Entry("rivers"))).key() == "c36c52c2667f3dffabc98cd6e9e7b43b"


def test_reading_returns_the_written_stack(tmp_path):
    write_stack(STACK, tmp_path / "stack.json")
    found = read_stack(tmp_path / "stack.json")
    mask = found.entries[1].mask
    assert mask.image == str(tmp_path / "masks" / "valley.png") and mask.rules == RULES and mask.factor == 0.75
    assert found.entries[0] == STACK.entries[0] and not found.entries[1].on
    write_stack(found, tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == stack_content(STACK), "names are relative again"
    assert stack_from(stack_content(found)) == found


def test_the_key_depends_on_everything_that_counts(tmp_path):
    key = STACK.key()
    assert Stack(STACK.entries[:1]).key() == key, "an entry that is off does nothing"
    assert Stack((Entry("hill", {"height": 7.5, "radius": 500.0}, seed=3),)).key() == key, "a default is a default"
    image = tmp_path / "m.png"
    image.write_bytes(b"1")
    keys = {
        key,
        Stack((Entry("hill", {"height": 7.5}, seed=4),)).key(),
        Stack((Entry("hill", mask=HeightMask(str(image))),)).key(),
    }
    image.write_bytes(b"2")
    os.utime(image, (1, 1))
    keys.add(Stack((Entry("hill", mask=HeightMask(str(image))),)).key())
    both = Entry("hill"), Entry("level")
    assert len(keys | {Stack(both).key(), Stack(both[::-1]).key()}) == 6


def test_the_key_follows_an_image_to_another_folder(tmp_path):
    """A store and its land can be moved or packed without shaping again."""
    image = tmp_path / "m.npy"
    image.write_bytes(b"1")
    key = Stack((Entry("hill", mask=HeightMask(str(image))),)).key()
    (tmp_path / "there").mkdir()
    moved = image.rename(tmp_path / "there" / "n.npy")
    os.utime(moved, (1, 1))
    assert Stack((Entry("hill", mask=HeightMask(str(moved))),)).key() == key
    picture = moved.rename(tmp_path / "n.png")
    assert Stack((Entry("hill", mask=HeightMask(str(picture))),)).key() != key, "it is read in another way"
    os.mkfifo(tmp_path / "pipe.npy")
    assert Stack((Entry("hill", mask=HeightMask(str(tmp_path / "pipe.npy"))),)).key() != key, "and nothing waits for it"


def one(**entry):
    return {"version": 1, "entries": [entry]}


WRONG = [
    ([], "expected an object with version, entries"),
    ({"version": 2, "entries": []}, "version 2; expected 1"),
    ({"version": True, "entries": []}, "expected 1"),
    ({"version": 1, "entries": {}}, "expected a list"),
    ({"version": 1, "entries": [], "extra": 1}, "'extra'"),
    ({"version": 1, "entries": [{"effect": "hill"}] * 65}, "has 65 entries; expected a list of at most 64"),
    (one(effect="lava"), "'lava'; expected one of"),
    (one(effect=3), "expected a text"),
    (one(effect="hill", parameters=[1]), "expected an object of numbers"),
    (one(effect="hill", parameters={"depth": 1}), "'depth'; expected some of: height, radius"),
    (one(effect="hill", parameters={"height": "7"}), "height '7'; expected a number"),
    (one(effect="hill", parameters={"height": True}), "expected a number"),
    (one(effect="hill", parameters={"height": float("nan")}), "expected a number"),
    (one(effect="hill", parameters={"height": 1e9}), "expected -10000 to 10000 m"),
    (one(effect="hill", seed=-1), "expected 0 to"),
    (one(effect="hill", seed=1.5), "expected a whole number"),
    (one(effect="hill", on=1), "expected true or false"),
    (one(effect="hill", mask={"factor": 2}), "factor of 2.0; expected 0 to 1"),
    (one(effect="hill", mask={"image": 7}), "expected the name of a file"),
    (one(effect="hill", mask={"rules": [{"of": "mood"}]}), "'mood'; expected one of: height, slope, aspect"),
    (one(effect="hill", mask={"rules": [{"of": "slope", "low": 95}]}), "expected numbers from -90 to 90 degrees"),
    (one(effect="hill", mask={"rules": [{"of": "slope", "low": 90, "high": 0}]}), "from 90 to 0; expected a low limit"),
    (one(effect="hill", mask={"rules": [{"of": "aspect", "direction": 3601}]}), "towards 3601 degrees; expected"),
    (one(effect="hill", mask={"rules": [{"of": "height", "edge": -1}]}), "with an edge of -1"),
    (one(effect="hill", mask={"rules": [{"of": "height"}] * 17}), "has 17 rules"),
]


@pytest.mark.parametrize(("content", "said"), WRONG, ids=lambda value: value if isinstance(value, str) else "")
def test_an_invalid_stack_gives_one_sentence_with_its_file(tmp_path, content, said):
    file = tmp_path / "stack.json"
    file.write_text(json.dumps(content))
    with pytest.raises(TerrainError) as error:
        read_stack(file)
    text = str(error.value)
    assert said in text and "\n" not in text and len(text) < 700 and str(file) in text


TWICE = b'{"version": 1, "entries": [{"effect": "hill", "effect": "level"}]}'


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe", b"{" * 100_000, b"[" * 2_000_000, b'{"version": 1e', TWICE, None]
)
def test_an_unreadable_file_is_refused(tmp_path, content):
    file = tmp_path / "stack.json"
    if content is None:
        os.mkfifo(file)
    else:
        file.write_bytes(content)
    with pytest.raises(TerrainError, match="cannot be read"):
        read_stack(file)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["version", "entries", "effect", "mask", "rules", "of", "parameters", "height", "seed"]),
            inner,
            max_size=5,
        )
    ),
    max_leaves=10,
)


@given(JSON)
def test_any_json_is_a_stack_or_an_error(content):
    for tried in (content, {"version": 1, "entries": [content]}, one(effect="rivers", mask=content)):
        try:
            stack_from(tried).key()
        except TerrainError as error:
            assert "\n" not in str(error)


def test_the_error_of_a_long_seed_is_short():
    with pytest.raises(TerrainError) as error:
        stack_from({"version": 1, "entries": [{"effect": "relief", "seed": 10**4000}]})
    assert len(str(error.value)) < 400 and "expected 0 to 2147483647" in str(error.value)
