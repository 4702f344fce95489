"""Errors that others hide are reported with them, those that a guess would cause are not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.explain import MOST_SHOWN, describe_error
from bayesnet_track.graph.text.load import errors_behind
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation.cue import installed_cues

HEAD = """bayesnet: 1
name: g
targets:
  t:
    nodes:
      root:
        belief: {particles: {size: 500}}
        motion: {random_walk: {sd_px: {x: 2, y: 2}}}
        fuse: product
"""


@pytest.fixture
def said(tmp_path):
    """(line, column, what was found) of each error of the root's lines and agents, in order."""

    def load(*lines):
        path = tmp_path / "g.yaml"
        path.write_text(HEAD + "".join(f"{line}\n" for line in lines))
        with pytest.raises(GraphError) as raised:
            load_graph(path)
        return [(one.line, one.column, one.found) for one in raised.value.errors]

    return load


def test_a_check_fails_behind_a_wrong_key_of_another_node(said):
    found = said(
        "        fusee: product",
        "      a: {parent: rot, agent: intensity}",
        "      b: {parent: root, agent: intensitty}",
    )
    assert found == [
        (10, 9, "unknown key 'fusee' of an inference node"),
        (11, 19, "unknown parent 'rot'"),
        (12, 32, "unknown cue 'intensitty'"),
    ]


def test_what_hides_others_comes_first(said):
    found = said("      a: {parent: rot, agent: intensity}", "      b: {parent: root, agentt: intensity}")
    assert [line for line, _, _ in found[:2]] == [11, 10]


def test_what_a_guess_would_cause_is_not_reported(said):
    """Without its noise the root could not jump, and without a node a child has no parent."""
    agent = "      a: {parent: root, agent: intensity}"
    noise = said("        motion2: {}", "        ud_fields: [x, q]", agent)
    assert [line for line, _, _ in noise] == [10, 11]
    missing = said(agent.replace("parent: root, ", ""), "      b: {parent: root, agent: foreground_color}")
    assert [(line, found) for line, _, found in missing] == [(10, "key 'parent' is missing")]


def test_nothing_below_a_guessed_key_is_reported(said):
    """Its keys may be those of another one, and they stand nowhere in the file."""
    found = said("        learm: {levl: 1}", "      a: {parent: root, agent: intensity}")
    assert found == [(10, 9, "unknown key 'learm' of an inference node")]


def test_what_is_no_node_is_an_error_and_no_crash(said):
    found = said("      a: true", "      b: {agent: intensity}")
    assert [line for line, _, _ in found] == [10, 11] and found[1][2] == "key 'parent' is missing"


def test_a_wrong_node_is_not_said_to_be_missing(said):
    """Taken out, an agent leaves its parent without one, and one of two children needs no `fuse`."""
    only = said("      a: {parent: root, agent: {}}")
    assert only and not [found for _, _, found in only if "no agent below" in found]


def test_cues_given_by_an_iterator_are_known_in_every_round(tmp_path):
    path = tmp_path / "g.yaml"
    path.write_text(
        HEAD + "      a: {parent: root, agent: {mine: {nope: 1}}}\n      b: {parent: root, agent: mine}\n"
    )
    own = replace(installed_cues()["intensity"], name="mine")
    with pytest.raises(GraphError) as raised:
        load_graph(path, cues=(one for one in [own]))
    assert not [one for one in raised.value.errors if "unknown cue" in one.found]


def test_a_sound_value_has_none_behind_and_is_left_as_it_is():
    value = {"targets": {"t": {"nodes": {"root": {"fuse": "product"}}}}}
    assert errors_behind(value, [], lambda mended: None) == []
    assert value == {"targets": {"t": {"nodes": {"root": {"fuse": "product"}}}}}


def test_no_more_than_ten_are_shown(said, tmp_path):
    found = said(*(f"      a{k}: {{parent: root, agent: nonsense}}" for k in range(MOST_SHOWN + 3)))
    with pytest.raises(GraphError) as raised:
        load_graph(tmp_path / "g.yaml")
    shown = describe_error(raised.value)
    assert shown.count("unknown cue") == MOST_SHOWN
    assert shown.endswith(f"g.yaml: and {len(found) - MOST_SHOWN} more")


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        (("fuse: product", "fuse product"), "in line 8, a key is followed by a colon and a space"),
        (("motion: {random_walk: {", "motion: random_walk: {sd: {"), "one key and one colon a line"),
        (("      a:", "      - a:"), "nodes and keys are no list: leave out the - at the beginning"),
    ],
)
def test_the_hint_points_at_the_line_that_is_wrong(wrong, hint, tmp_path):
    text = """bayesnet: 1
name: x
targets:
  t:
    nodes:
      t:
        motion: {random_walk: {sd_px: {x: 6, y: 6}}}
        fuse: product
        estimate: map
      a: {parent: t, agent: intensity}
"""
    (tmp_path / "x.yaml").write_text(text.replace(*wrong))
    with pytest.raises(GraphError) as error:
        load_graph(tmp_path / "x.yaml")
    assert hint in describe_error(error.value)


def test_queries_are_all_checked_behind_one_of_a_wrong_form(said):
    found = said(
        "      a: {parent: root, agent: intensity}",
        "queries:",
        "  crossed: {of: t, crosses: {line: [1, 2, 3, 4]}}",
        '  near: {of: t, probability: "x > 3 & y > 4", interval: 2}',
        '  far: {of: t, probability: "x + 3"}',
    )
    assert [(line, column) for line, column, _ in found] == [(12, 36), (13, 57), (13, 37), (14, 29)]
