"""Records with other values, as `dataclasses.replace` makes them; values that are found when asked for."""

import pickle
from dataclasses import dataclass, field, replace
from functools import cached_property

import pytest

from bayesnet_track.numerics.records import LazyRecords, evolve


@dataclass(frozen=True)
class Box:
    width: int
    height: int = 2
    marks: tuple[int, ...] = field(default_factory=tuple)

    @cached_property
    def area(self) -> int:
        return self.width * self.height


def test_a_record_is_changed_as_replace_does():
    before = Box(3, marks=(1,))
    assert evolve(before, height=5) == replace(before, height=5) == Box(3, 5, (1,))
    assert evolve(before) == before and before == Box(3, 2, (1,))


def test_what_was_cached_in_a_record_is_not_kept():
    before = Box(3)
    assert before.area == 6
    assert evolve(before, height=5).area == 15
    assert evolve(before, width=4).area == 8


def test_a_field_that_the_class_has_not_is_refused():
    with pytest.raises(TypeError, match="Box has no field depth"):
        evolve(Box(3), depth=1)


def test_all_are_found_once_when_the_first_is_asked_for():
    asked = []

    def find():
        asked.append("all")
        return {"a": 1.0, "b": 2.0}

    values = LazyRecords(["a", "b"], find)
    assert list(values) == ["a", "b"] and len(values) == 2 and "a" in values and "c" not in values
    assert asked == []  # names alone need no value
    assert values["b"] == 2.0 and values == {"a": 1.0, "b": 2.0} and asked == ["all"]
    with pytest.raises(KeyError):
        values["c"]


def test_they_are_pickled_as_values():
    assert pickle.loads(pickle.dumps(LazyRecords(["a"], lambda: {"a": 1.0}))) == {"a": 1.0}
