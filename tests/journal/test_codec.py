"""Events become lines and come back, for every class, up to the rounding of floats."""

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from types import UnionType
from typing import get_args, get_origin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.journal.codec import (
    JournalError,
    event_classes,
    event_name,
    from_json,
    to_json,
    type_hints,
)
from bayesnet_track.journal.encoder import FLOAT_DIGITS, encode_clouds, members_encoder
from bayesnet_track.journal.events.lives import TargetDied
from bayesnet_track.journal.events.runs import JOURNAL_VERSION, RunEnded, RunStarted, SourceDamaged
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.target_net import Cause

SIMPLE = {
    float: st.floats(),
    int: st.integers(-(2**62), 2**62),
    str: st.text(),
    bool: st.booleans(),
    type(None): st.none(),
}


def strategy_of(hint):
    """Every value of a type hint."""
    inner = get_args(hint)
    if hint in SIMPLE:
        return SIMPLE[hint]
    if isinstance(hint, UnionType):
        return st.one_of(*map(strategy_of, inner))
    if is_dataclass(hint):
        made = st.builds(hint, **{name: strategy_of(part) for name, part in type_hints(hint).items()})
        # A later format is refused.
        return made.map(lambda event: replace(event, journal=JOURNAL_VERSION)) if hint is RunStarted else made
    if get_origin(hint) is tuple and inner[-1] is Ellipsis:
        return st.lists(strategy_of(inner[0]), max_size=4).map(tuple)
    if get_origin(hint) is tuple:
        return st.tuples(*map(strategy_of, inner))
    assert issubclass(get_origin(hint), Mapping)
    return st.dictionaries(strategy_of(inner[0]), strategy_of(inner[1]), max_size=3)


def same(a, b):
    """Equal, floats to half a unit of the last digit kept."""
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, Mapping):
        return set(a) == set(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float):
        # A value with d digits differs from the exact one by at most half a unit of digit d.
        near = math.isclose(a, b, rel_tol=0.5000001 * 10.0 ** (1 - FLOAT_DIGITS), abs_tol=1e-320)
        return isinstance(b, float) and ((math.isnan(a) and math.isnan(b)) or near)
    return type(a) is type(b) and a == b


EVENTS = st.one_of(*map(strategy_of, event_classes().values()))


@given(EVENTS)
def test_round_trip(event):
    line = to_json(event)
    back = from_json(line)
    assert same(event, back)
    assert to_json(back) == line


def left_out(item, one):
    default = item.default if item.default_factory is MISSING else item.default_factory()
    return item.metadata.get("left_out_when_empty") and one == default


def plain(value):
    """What a line holds, by the values alone: for `json.dumps`."""
    if is_dataclass(value):
        given = {item: getattr(value, item.name) for item in fields(value)}
        kept = {f: one for f, one in given.items() if not left_out(f, one)}
        return {f.metadata.get("key", f.name): plain(one) for f, one in kept.items()}
    if isinstance(value, Mapping):
        return {key: plain(value[key]) for key in sorted(value)}
    if isinstance(value, tuple):
        return [plain(one) for one in value]
    if isinstance(value, float) and math.isfinite(value):
        return float(f"{value:.{FLOAT_DIGITS}g}") + 0.0
    if isinstance(value, float):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


@given(EVENTS)
def test_a_line_is_what_json_makes_of_its_values(event):
    assert to_json(event) == json.dumps({"event": event_name(type(event)), **plain(event)}, allow_nan=False)


@given(st.one_of(st.floats(), st.integers(-(10**10), 10**10).map(float), st.floats(-1e-3, 1e-3)))
def test_a_float_is_python_s_own_text_of_its_first_nine_digits(value):
    line = to_json(StatusChanged(1, "t", "lost", cause(turning=value), ""))
    assert f'"turning": {json.dumps(plain(value))}, ' in line


@given(EVENTS)
def test_a_line_is_one_ascii_line_of_strict_json(event):
    line = to_json(event)
    assert "\n" not in line and line.isascii()

    def refuse(word):
        raise AssertionError(word)

    json.loads(line, parse_constant=refuse)


@pytest.mark.parametrize("kind", event_classes().values(), ids=lambda kind: kind.__name__)
def test_every_class_is_generated_and_named(kind):
    seen = []

    @settings(max_examples=5, deadline=None, database=None)
    @given(strategy_of(kind))
    def check(event):
        seen.append(type(from_json(to_json(event))))

    check()
    assert set(seen) == {kind}


def cause(turning=213.0):
    return Cause("ud_px2", 200.0, 212.0, 3, turning, 212.0, 1.0)


def test_the_line_of_an_activation_is_stable():
    event = Activated(29, "square", "motion", "square", cause(), 1 / 3)
    assert to_json(event) == (
        '{"event": "activated", "frame": 29, "target": "square", "node": "motion", "governor": "square", '
        '"cause": {"unit": "ud_px2", "level": 200.0, "value": 212.0, "frames": 3, "turning": 213.0, '
        '"ud_px2": 212.0, "scale_px2": 1.0}, "helpfulness": 0.333333333, "expected": {}}'
    )


def test_a_probability_of_zero_is_written_and_none_is_not():
    gone = TargetDied(3, "1", "unseen", 2, 2, False)
    assert '"existence": 0.0' in to_json(replace(gone, existence=0.0))
    assert "existence" not in to_json(gone)


def test_equal_events_give_equal_lines():
    one = Deactivated(1, "t", "n", "g", cause(), "largest_kl", {"a": 1.0, "b": -0.0})
    two = Deactivated(1, "t", "n", "g", cause(), "largest_kl", {"b": 0.0, "a": 1.0})
    assert one == two
    assert to_json(one) == to_json(two)


def test_numpy_scalars_are_written_as_numbers():
    plain = RunEnded(3, None, True, "end_of_source")
    assert to_json(RunEnded(np.int64(3), None, np.True_, "end_of_source")) == to_json(plain)


def test_non_finite_numbers_are_texts():
    event = StatusChanged(1, "t", "lost", cause(turning=math.inf), "")
    assert '"turning": "Infinity"' in to_json(event)
    assert from_json(to_json(event)) == event


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{"event": "explosion", "frame": 1}', "unknown event 'explosion'"),
        ('{"frame": 1}', 'no object with a key "event"'),
        ("[1]", 'no object with a key "event"'),
        ("", "not a line of JSON"),
        ('{"event": "source_damaged", "frame": NaN, "reason": ""}', "not a line of JSON"),
        ("[" * 100_000, "not a line of JSON"),
        ('{"event": "source_damaged", "frame": 1}', "missing fields ['reason']"),
        ('{"event": "source_damaged", "frame": 1, "reason": "", "x": 1}', "unknown fields ['x']"),
        ('{"event": "source_damaged", "frame": 1.5, "reason": ""}', "source_damaged.frame: 1.5 is not int"),
        ('{"event": "source_damaged", "frame": true, "reason": ""}', "source_damaged.frame: True is not int"),
        ('{"event": "source_damaged", "frame": 1, "reason": null}', "source_damaged.reason: None is not str"),
    ],
)
def test_a_wrong_line_is_refused_with_its_fault(line, words):
    with pytest.raises(JournalError) as caught:
        from_json(line)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "event",
    [
        SourceDamaged(1.5, "x"),
        SourceDamaged(1, None),
        Deactivated(1, "t", "n", "g", None, "largest_kl"),
        StatusChanged(1, "t", "lost", 3),
    ],
)
def test_a_value_of_the_wrong_type_is_refused_when_written(event):
    with pytest.raises(JournalError):
        to_json(event)


def test_an_object_that_is_no_event_is_refused():
    with pytest.raises(JournalError, match="Cause is not an event"):
        to_json(cause())


def test_frame_metrics_keep_their_cloud():
    hints = type_hints(FrameMetrics)
    values = {name: {} if get_origin(h) is Mapping else () for name, h in hints.items()}
    values |= {name: 1.5 for name, h in hints.items() if h is float}
    values |= {
        "frame": 4,
        "particles": 2,
        "target": "t",
        "status": "tracking",
        "quiet_px2": None,
        "join": None,
        "hidden": None,
        "existence": None,
        "e_value": 12.5,
    }
    metrics = FrameMetrics(**{**values, "cloud": ((1, 2, 3, 4), (5, 6, 7, 8))})
    assert from_json(to_json(metrics)) == metrics


@dataclass
class Drawn:
    cloud: tuple[tuple[int, ...], ...]


def test_clouds_that_are_made_together_have_the_text_of_each():
    drawn = np.random.default_rng(0).integers(-5, 2000, (3, 6, 4))
    write = members_encoder(Drawn, "drawn")
    for one, numbers in zip(encode_clouds(drawn), drawn.tolist(), strict=True):
        own = tuple(map(tuple, numbers))
        assert one == own
        assert write(Drawn(one)) == write(Drawn(own)) == [f'"cloud": {numbers}']


@pytest.mark.parametrize(
    "box", [(1, 2, 3, 4), [1, 2, 3, 4], tuple(np.arange(1, 5))], ids=["own", "list", "numpy"]
)
def test_a_cloud_is_written_alike_whatever_holds_its_whole_numbers(box):
    write = members_encoder(Drawn, "drawn")
    assert write(Drawn((box, (5, 6, 7, 8)))) == ['"cloud": [[1, 2, 3, 4], [5, 6, 7, 8]]']
    assert write(Drawn(())) == ['"cloud": []']
    with pytest.raises(JournalError, match=r"drawn\.cloud"):
        write(Drawn((box, (1.5, 2, 3, 4))))


@pytest.mark.parametrize(
    "number", ["1" + "0" * 400, "-1" + "0" * 400, "1e999", "Infinity", "-Infinity", "NaN"]
)
def test_a_whole_number_that_is_none_or_too_large_is_refused(number):
    with pytest.raises(JournalError, match=r"is not (int|JSON)"):
        from_json(f'{{"event": "source_damaged", "frame": {number}, "reason": "x"}}')
