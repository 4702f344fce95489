"""Values that are found when they are asked for, once, and travel as they are."""

import pickle

import pytest

from bayesnet_track.numerics.found import Found


def test_all_are_found_once_when_the_first_is_asked_for():
    asked = []

    def find():
        asked.append("all")
        return {"a": 1.0, "b": 2.0}

    values = Found(["a", "b"], find)
    assert list(values) == ["a", "b"] and len(values) == 2 and "a" in values and "c" not in values
    assert asked == []  # names alone need no value
    assert values["b"] == 2.0 and values == {"a": 1.0, "b": 2.0} and asked == ["all"]
    with pytest.raises(KeyError):
        values["c"]


def test_they_are_pickled_as_values():
    assert pickle.loads(pickle.dumps(Found(["a"], lambda: {"a": 1.0}))) == {"a": 1.0}
