"""Keys: equal where ranges are written alike, hashed and sorted by it, and read back."""

from __future__ import annotations

import json

import pytest

from labkit.key import Key, same_range
from labkit.results.schema import WhereEntry


def test_ranges_that_round_alike_are_one_key() -> None:
    assert Key(3200, "G") == Key(3200.000001, "G")
    assert len({Key(0.1 + 0.2, "G"), Key(0.3, "G")}) == 1
    assert Key(3200.0, "G") != Key(3200.0001, "G")
    assert same_range(3200.0, 3200.000001)
    assert not same_range(None, 0.0)


@pytest.mark.parametrize(
    ("key", "name", "label"),
    [
        (Key(3200.0, "G"), "3200_G", "G at 3200 mm"),
        (Key(1234.5678, "B"), "1234.5678_B", "B at 1234.5678 mm"),
        (Key(None, "G"), "none_G", "G"),
        (Key(3200.0, "G", (0, 2)), "3200_G_0_2", "G at 3200 mm, tile (0, 2)"),
    ],
)
def test_a_key_has_a_name_and_a_label(key: Key, name: str, label: str) -> None:
    assert (str(key), key.array_name, key.label) == (name, name, label)
    entry = WhereEntry.model_validate_json(json.dumps(key.as_json()))
    assert entry.key == key


def test_keys_without_a_range_come_first_and_whole_frames_before_tiles() -> None:
    expected = [
        Key(None, "R"),
        Key(900.0, "R"),
        Key(3200.0, "B"),
        Key(3200.0, "B", (0, 1)),
        Key(3200.0, "G"),
    ]
    mixed = [expected[k] for k in (3, 0, 4, 2, 1)]
    assert sorted(mixed) == expected


@pytest.mark.parametrize(
    "entry",
    [{}, {"range_mm": "near", "channel": "G"}, {"range_mm": 1, "channel": "G", "tile": 3}],
)
def test_what_is_no_key_is_refused(entry: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        WhereEntry.model_validate_json(json.dumps(entry))
