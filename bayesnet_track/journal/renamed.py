"""Words of format 1 of the journal that have been renamed since; its lines are read in today's words."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

EVENTS: Mapping[str, str] = MappingProxyType({"rival_seen": "distractor_seen"})
"""Name of an event -> its new name."""

FIELDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "Deactivated": {"glance": "sample_every"},
        "Recognition": {"least_probability": "min_probability"},
        "BirthsRefused": {"most": "max_targets"},
    }
)
"""Class -> field -> its new name."""

VALUES: Mapping[str, Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "Deactivated": {
            "drop": {
                "dearest": "most_expensive",
                "dearest_dispensable": "most_expensive_redundant",
                "least_contribution_per_ms": "min_contribution_per_ms",
                "least_information_per_ms": "min_information_per_ms",
            }
        },
        "SecondPass": {"method": {"adaptive": "second_pass", "west": "iterated"}},
        "Cause": {"unit": {"ud_quiet": "ud_baseline"}},
    }
)
"""Class -> field -> value -> its new value."""


def in_new_words(kind: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of an object of a class, in today's words.

    >>> in_new_words("Deactivated", {"drop": "dearest", "glance": 3})
    {'drop': 'most_expensive', 'sample_every': 3}
    """
    fields, words = FIELDS.get(kind, {}), VALUES.get(kind, {})
    if not fields and not words:
        return values
    return {
        fields.get(name, name): words[name].get(value, value)
        if name in words and isinstance(value, str)
        else value
        for name, value in values.items()
    }
