"""The bounded reader of YAML: limits, scalars, positions, and nothing executed."""

from __future__ import annotations

import copy
import json
import math
import re
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.document import MAX_BYTES, MAX_NODES, plain_scalar, read_document
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

PLACED = re.compile(r"(g\.yaml:[1-9]\d*:[1-9]\d*: \S.*: .|g\.yaml: and more errors$)")


def _error(text):
    with pytest.raises(GraphError) as error:
        read_graph(text, "g.yaml")
    return str(error.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"),
        ("yes", "yes"),
        ("no", "no"),
        ("y", "y"),
        ("true", True),
        ("False", False),
        ("1:30", "1:30"),
        ("190:20:30", "190:20:30"),
        ("010", 10),
        ("0o10", 8),
        ("0xff", 255),
        ("0b1", "0b1"),
        ("1_000", "1_000"),
        ("+1", 1),
        ("-1.5", -1.5),
        (".5", 0.5),
        ("5.", 5.0),
        ("1e3", 1000.0),
        ("2001-01-01", "2001-01-01"),
        ("~", None),
        ("Null", None),
        ("", None),
        ("-.inf", -math.inf),
        ("=", "="),
        ("<<", "<<"),
        ("٣", "٣"),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text, value):
    found = plain_scalar(text)
    assert found == value
    assert type(found) is type(value)


def test_not_a_number():
    assert math.isnan(plain_scalar(".nan"))


def test_every_key_and_value_knows_its_place():
    document = read_document("a: 1\nb:\n  - x\n  - {ü: 'y z'}\n", "g.yaml")
    assert document.value == {"a": 1, "b": ["x", {"ü": "y z"}]}
    assert document.at.keys == {("a",): (1, 1), ("b",): (2, 1), ("b", 1, "ü"): (4, 6)}
    assert document.at.values[("a",)] == (1, 4)
    assert document.at.values[("b", 0)] == (3, 5)
    assert document.at.values[("b", 1, "ü")] == (4, 9)


def test_a_byte_order_mark_is_no_column():
    document = read_document("\ufeffa: 1".encode(), "g.yaml")
    assert document.at.keys[("a",)] == (1, 1)


def test_dos_line_ends_count_once():
    assert read_document("a: 1\r\nb: 2\r\n", "g.yaml").at.keys[("b",)] == (2, 1)


def test_keys_are_their_text():
    assert read_document("1: a\ntrue: b\n~: c\n1.50: d\n", "g.yaml").value == dict(
        zip(("1", "true", "~", "1.50"), "abcd", strict=True)
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "g.yaml:1:1: graph: nothing in the file; allowed: a mapping that begins with bayesnet: 1"),
        ("na\0me", "g.yaml:1:3: graph: character U+0000; allowed: printable characters"),
        ("name: g\nabout: a\x07b\n", "g.yaml:2:9: graph: character U+0007; allowed: printable characters"),
        ("about: a\u2028b\n", "g.yaml:1:9: graph: character U+2028; allowed: printable characters"),
        ("a\r\nb\ufeff", "g.yaml:2:2: graph: character U+FEFF; allowed: printable characters"),
        ("a\ud800", "g.yaml:1:2: graph: byte 0xed that is not UTF-8; allowed: text in UTF-8"),
        (
            b"name: g\nabout: caf\xe9\n",
            "g.yaml:2:11: graph: byte 0xe9 that is not UTF-8; allowed: text in UTF-8",
        ),
        (
            "name: g".encode("utf-16"),
            "g.yaml:1:1: graph: byte 0xff that is not UTF-8; allowed: text in UTF-8",
        ),
        ("#" * MAX_BYTES + "\n", "g.yaml:1:1: graph: more than 65536 bytes; allowed: at most 65536 bytes"),
        (
            "about: " + "x" * 5000,
            "g.yaml:1:8: graph: a value of 5000 characters; allowed: at most 4096 characters",
        ),
        ("bayesnet: " + "1" * 30, "g.yaml:1:11: graph: a number of 30 digits; allowed: at most 18 digits"),
        ("[" * 40, "g.yaml:1:33: graph: nested deeper than 32 levels; allowed: at most 32 levels"),
        ("- " * 40, "g.yaml:1:65: graph: nested deeper than 32 levels; allowed: at most 32 levels"),
        (
            "[" + "a," * MAX_NODES + "]",
            "g.yaml:1:40000: graph: more than 20000 values; allowed: at most 20000 values",
        ),
    ],
    ids=lambda value: repr(value)[:24],
)
def test_limits_and_characters(text, said):
    assert _error(text) == said


PROBES = [
    "!!python/object/apply:os.system ['touch PWNED']",
    "!!python/object/apply:subprocess.check_output [[touch, PWNED]]",
    "!!python/object/new:os.system ['touch PWNED']",
    "!!python/name:os.system",
    "!!python/module:os",
    "!!python/object/apply:builtins.eval [\"open('PWNED','w')\"]",
    "!!python/object:collections.OrderedDict {a: 1}",
    "!<tag:yaml.org,2002:python/object/apply:os.system> ['touch PWNED']",
    "!ENV ${HOME}",
    "!include /etc/passwd",
    "!!timestamp 2001-01-01",
    "!!binary aGk=",
    "!!set {a, b}",
]


@pytest.mark.parametrize("probe", PROBES)
@pytest.mark.parametrize("place", ["{}", "name: {}", "{}: x", "targets: [{}]"])
def test_nothing_is_executed(probe, place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = _error(place.replace("{}", probe, 1))
    assert list(tmp_path.iterdir()) == []
    assert PLACED.match(said)


@pytest.mark.parametrize(
    "word",
    ["${HOME}", "{{ 1 + 1 }}", "$(touch PWNED)", "`touch PWNED`", "../../etc/passwd", "http://x/y.yaml"],
)
def test_words_stay_words(word):
    document = read_document(f"name: '{word}'", "g.yaml")
    assert document.value == {"name": word}


HOSTILE = {
    "deep lists": "[" * 60_000,
    "deep mappings": "{" * 60_000,
    "deep keys": "{a: " * 16_000,
    "deep keys in lists": "[a:b," * 13_000,
    "deep blocks": "- " * 30_000,
    "deep questions": "? " * 30_000,
    "many aliases": "a: &a [x]\nb: [" + "*a," * 15_000 + "]",
    "laughs": "a: &a [x,x]\n"
    + "".join(f"{chr(i)}: &{chr(i)} [*{chr(i - 1)},*{chr(i - 1)}]\n" for i in range(98, 123)),
    "self alias": "&a [*a]",
    "duplicate keys": "a: 1\n" * 10_000,
    "long number": "bayesnet: " + "1" * 60_000,
    "sexagesimal": "bayesnet: " + "1:" * 30_000 + "1",
    "long float": "bayesnet: 1." + "1" * 60_000,
    "exponent": "bayesnet: 1e" + "9" * 4_000,
    "merges": "a: {" + "<<: {b: 1}, " * 4_000 + "}",
    "tags": "a: [" + "!x y, " * 9_000 + "]",
    "comments": "#\n" * 30_000,
    "blank lines": "\n" * 60_000,
    "quotes": '"' * 60_000,
    "block scalar": "a: |\n" + " x\n" * 20_000,
    "directive": "%YAML 9.9\n---\na: 1\n",
    "tag directive": "%TAG ! tag:x,2000:\n---\n!a b\n",
    "unknown keys": "".join(f"key{i}: 1\n" for i in range(5_000)),
    "unknown parents": "name: g\ntargets:\n t:\n  nodes:\n"
    + "".join(f"   node{i}: {{parent: nodf{i}}}\n" for i in range(1_700)),
    "long chain": "name: g\ntargets:\n t:\n  nodes:\n   n0: {}\n"
    + "".join(f"   n{i}: {{parent: n{i - 1}}}\n" for i in range(1, 2_000)),
    "long cycle": "name: g\ntargets:\n t:\n  nodes:\n"
    + "".join(f"   n{i}: {{parent: n{(i + 1) % 2_000}}}\n" for i in range(2_000)),
    "many twins": "name: g\ntargets:\n t:\n  nodes:\n   s: {motion: constant_velocity, fuse: product}\n"
    + "".join(f"   n{i}: {{parent: s, agent: hue}}\n" for i in range(1_500)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_with_a_place(name, cues):
    began = time.process_time()
    with pytest.raises(GraphError) as error:
        spec, at = read_graph(HOSTILE[name], "g.yaml")
        check(spec, at, cues)
    # The bound proper is a benchmark; this only tells seconds, also of a slow machine, from minutes.
    assert time.process_time() - began < 60
    assert all(PLACED.match(line) for line in str(error.value).splitlines())


_pieces = st.sampled_from(
    [
        *"{}[]:,-?|>&*!%@`#'\"\n\t ~=<",
        "\n  ",
        ": ",
        "- ",
        "---\n",
        "...\n",
        "<<: ",
        "&a ",
        "*a",
        "!!str ",
        "name",
        "targets",
        "t",
        "nodes",
        "parent",
        "agent",
        "fuse",
        "pool",
        "adapt",
        "1e999",
        ".nan",
        "0x",
        "null",
        "\0",
        "\ufeff",
        "\u2028",
        "é",
        "😀",
    ]
)


@given(st.lists(_pieces, max_size=40).map("".join) | st.text(max_size=60) | st.binary(max_size=60))
def test_any_input_is_read_or_refused_with_a_place(text):
    try:
        read_graph(text, "g.yaml")
    except GraphError as error:
        assert error.errors
        assert all(PLACED.match(line) for line in str(error).splitlines())


_plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(data=st.data())
def test_a_graph_with_any_value_anywhere_is_checked_or_refused(everything, cues, data):
    graph = copy.deepcopy(everything)
    inside = graph
    while True:
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        key = data.draw(st.sampled_from(keys))
        deeper = isinstance(inside[key], (dict, list)) and len(inside[key]) > 0
        if not deeper or data.draw(st.integers(0, 4)) == 0:
            break
        inside = inside[key]
    inside[key] = data.draw(_plain)
    try:
        check(*read_graph(json.dumps(graph), "g.yaml"), cues)
    except GraphError as error:
        assert all(PLACED.match(line) for line in str(error).splitlines())
