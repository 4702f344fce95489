"""Values set in the text of a graph: in place, with their comment, everything else as it was."""

from __future__ import annotations

import pytest
import yaml

from bayesnet_track import load_graph
from bayesnet_track.graph.text.change import set_value
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graphs import find_graph, graph_names

TEXT = """# a graph
nodes:
  root:
    belief: {size: 9}   # so many
    adapt:
      on:
        above: 3        # px
      # about off
      off: {below: 2}

  # the agents
  hue: {parent: root, agent: {h: {floor: 0.1}}}  # hue
  blobs: {
    parent: root,
    agent: blobs,
  }
"""


def test_a_new_key_is_the_last_of_its_mapping():
    found = set_value(TEXT, ("nodes", "root", "localization_error"), {"sd": 0.1}, "from 3 videos")
    before, after = TEXT.split("\n\n", 1)
    assert found == f"{before}\n    # fit: from 3 videos\n    localization_error: {{sd: 0.1}}\n\n{after}"


def test_a_value_is_replaced_in_place_and_keeps_the_comment_behind_it():
    found = set_value(TEXT, ("nodes", "root", "belief"), {"size": 5})
    assert found == TEXT.replace("{size: 9}", "{size: 5}")
    found = set_value(TEXT, ("nodes", "root", "adapt", "on", "above"), 4, "two\nlines")
    wanted = "        # fit: two\n        # fit: lines\n        above: 4        # px"
    assert found == TEXT.replace("        above: 3        # px", wanted)


def test_a_block_gives_way_to_one_line():
    found = set_value(TEXT, ("nodes", "root", "adapt"), {"a": 1})
    assert yaml.safe_load(found)["nodes"]["root"] == {"belief": {"size": 9}, "adapt": {"a": 1}}
    assert "# the agents" in found


def test_mappings_in_one_line_grow_at_their_end():
    found = set_value(TEXT, ("nodes", "hue", "t"), 1.5, "x")
    wanted = "  # fit: x\n  hue: {parent: root, agent: {h: {floor: 0.1}}, t: 1.5}  # hue"
    assert found == TEXT.replace("  hue: {parent: root, agent: {h: {floor: 0.1}}}  # hue", wanted)
    found = set_value(TEXT, ("nodes", "blobs", "t"), 1.5)
    assert yaml.safe_load(found)["nodes"]["blobs"] == {"parent": "root", "agent": "blobs", "t": 1.5}


@pytest.mark.parametrize(
    "path", [("nodes", "root", "new"), ("nodes", "hue", "t"), ("nodes", "root", "adapt", "off", "below")]
)
def test_setting_again_leaves_one_comment(path):
    once = set_value(TEXT, path, 1, "first")
    again = set_value(once, path, 2, "second")
    assert again == once.replace("first", "second").replace(f"{path[-1]}: 1", f"{path[-1]}: 2")


def test_a_mapping_that_is_not_there_is_an_error():
    with pytest.raises(KeyError):
        set_value(TEXT, ("nodes", "sky", "t"), 1)
    with pytest.raises(KeyError):
        set_value(TEXT, ("nodes", "root", "belief", "size", "t"), 1)


@pytest.mark.parametrize("name", graph_names())
def test_every_graph_of_the_library_can_be_written_into(name):
    text, graph = find_graph(name).read_text(encoding="utf-8"), load_graph(name)
    for plate, target in graph.targets.items():
        node = ("targets", plate, "nodes")
        changed = set_value(text, (*node, target.root, "localization_error"), {"sd_box": 0.125}, "c")
        changed = set_value(changed, (*node, target.agents[0], "temperature"), 1.75, "c")
        spec, _ = read_graph(changed)
        assert spec.targets[plate].nodes[target.root].localization_error.sd_box == 0.125
        assert spec.targets[plate].nodes[target.agents[0]].temperature == 1.75
        kept = [line for line in text.splitlines() if line.lstrip().startswith("#")]
        assert all(line in changed.splitlines() for line in kept)
