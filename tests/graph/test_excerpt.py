"""What a terminal shows of a wrong graph: the line, a caret, and a hint for the usual slips."""

from __future__ import annotations

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.explain import WIDTH, describe_error
from bayesnet_track.graph.text.hints import A_NODE, RULES, hint_of
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graphs import find_graph
from bayesnet_track.observation.settings import by_command_line

SLIPS = {
    "    nodes:\n": (
        "\tnodes:\n",
        """\
wrong.yaml:12:1: graph: not YAML: while scanning for the next token found character '\\t' that \
cannot start any token
  12 |  nodes:
     | ^
  hint: YAML is indented by spaces; a tab stands at the beginning of this line""",
    ),
    "{size: 500}}": (
        "{size: 500}",
        """\
wrong.yaml:15:9: graph: not YAML: while parsing a flow mapping from line 14 expected ',' or '}', \
but got '<scalar>'
  15 |         motion:                      # where the square may be in the next frame: 10 px around, same
     |         ^
  hint: the brace { in line 14 is not closed, or a comma is missing""",
    ),
    "name: two": (
        'name: "two',
        """\
wrong.yaml:30:1: graph: not YAML: while scanning a quoted scalar from line 7 found unexpected end of stream
  hint: the quote in line 7 is not closed""",
    ),
    "bayesnet: 1  ": (
        "bayesnet 1  ",
        """\
wrong.yaml:7:1: graph: not YAML: expected '<document start>', but found '<block mapping start>'
  7 | name: two_squares
    | ^
  hint: a key is followed by a colon and a space, as in bayesnet: 1""",
    ),
    "      color:": (
        "     color:",
        """\
wrong.yaml:25:6: graph: not YAML: while parsing a block mapping from line 12 expected <block end>, but found \
'<block mapping start>'
  25 |      color: {parent: square, agent: {color_histogram: {floor: 0.003}}}
     |      ^
  hint: the keys of one mapping begin in the same column; this one does not""",
    ),
    "belief: {particles: {size: 500}}": (
        "belief: kalman",
        """\
wrong.yaml:14:9: square: unknown belief 'kalman'; allowed: particles, gaussian, grid
  14 |         belief: kalman
     |         ^
  hint: a Kalman filter is a filter of the Gaussian belief: write belief: {gaussian: {filter: kalman}}""",
    ),
    "particles: {size: 500}": (
        "particles: 800",
        """\
wrong.yaml:14:29: square: particles is 800; allowed: a mapping with size, min, max, resample, when, proposal
  14 |         belief: {particles: 800}
     |                             ^
  hint: write particles: {size: 800}""",
    ),
    "size: 500": (
        "size:500",
        """\
wrong.yaml:14:38: square: size:500 is empty; allowed: a value, or no such key
  14 |         belief: {particles: {size:500}}
     |                                      ^
  hint: a space follows the colon: size: 500""",
    ),
    "above: {ud_px2: 130}": (
        "above: 130",
        """\
wrong.yaml:22:29: square: above is 130; allowed: one of ud_px2, ud_box, ud_baseline, score
  22 |           activate: {above: 130, frames: 1}
     |                             ^
  hint: write above: {ud_px2: 130}, px²""",
    ),
    "{x: 10, y: 10}": (
        "{x: 1,5, y: 10}",
        """\
wrong.yaml:16:39: square: 5 is empty; allowed: a value, or no such key
  16 |           random_walk: {sd_px: {x: 1,5, y: 10}}
     |                                       ^
  hint: numbers have a decimal point, no comma""",
    ),
    "color_histogram: {floor: 0.003}": (
        "zoom: {floor: 0.003}",
        """\
wrong.yaml:25:39: color: unknown cue 'zoom'; allowed: camshift, color_blobs, color_histogram, \
color_kernel_histogram, correlation_filter, detection, displacement, embedding, foreground_color, intensity, \
klt, mean_shift, ... (10 more)
  25 |       color: {parent: square, agent: {zoom: {floor: 0.003}}}
     |                                       ^
  hint: a cue of your own is given as --cue-file FILE, one of another package as --allow-plugins NAME""",
    ),
    "        fuse: product": (
        "        fuse product",
        """\
wrong.yaml:18:9: graph: not YAML: while scanning a simple key from line 17 could not find expected ':'
  18 |         ud_fields: [x, y]            # UD counts the position; the size does not change here
     |         ^
  hint: in line 17, a key is followed by a colon and a space, as in bayesnet: 1""",
    ),
    "      color: {": (
        "      - color: {",
        """\
wrong.yaml:25:7: graph: not YAML: while parsing a block mapping from line 13 expected <block end>, \
but found '-'
  25 |       - color: {parent: square, agent: {color_histogram: {floor: 0.003}}}
     |       ^
  hint: nodes and keys are no list: leave out the - at the beginning""",
    ),
    "          deactivate:": (
        "        deactivate:",
        """\
wrong.yaml:23:9: square: unknown key 'deactivate' of an inference node; allowed: parent, belief, motion, \
start, modes, category, estimate, fuse, correlation, ud_fields, adapt, learn, ... (7 more)
  23 |         deactivate: {below: {ud_px2: 105}, frames: 6, drop: largest_kl}
     |         ^
  hint: `deactivate` is a key of `adapt`: indent it under `adapt:`""",
    ),
    "parent: square, ": (
        "",
        """\
wrong.yaml:25:14: color: key 'parent' is missing; allowed: square
  25 |       color: {agent: {color_histogram: {floor: 0.003}}}
     |              ^
  hint: an agent scores the hypotheses of the node above it; name that node, as in parent: square; \
a root has no agent""",
    ),
}
"""What stands in two_squares -> what is written instead, and what is shown then."""


@pytest.mark.parametrize("right", SLIPS)
def test_a_usual_slip_is_shown_with_its_line_and_a_hint(right, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wrong, shown = SLIPS[right]
    text = find_graph("two_squares").read_text(encoding="utf-8")
    assert right in text
    (tmp_path / "wrong.yaml").write_text(text.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(GraphError) as raised:
        load_graph("./wrong.yaml")
    with by_command_line():
        assert describe_error(raised.value).replace("./wrong", "wrong") == shown


def test_every_rule_is_for_a_slip_of_this_file():
    """Brackets and a second form of the missing colon besides: their words are those of braces and colons."""
    assert len(RULES) <= len(SLIPS) + 2


@pytest.mark.parametrize(
    ("root", "above"), [("s: {fuse: product}, ", "s"), ("a: {parent: a, factor: '1'}, ", "NODE")]
)
def test_the_hint_on_a_missing_parent_names_a_node_that_could_be_it(root, above):
    with pytest.raises(GraphError) as raised:
        read_graph(f"name: g\ntargets: {{t: {{nodes: {{{root}b: {{agent: motion}}}}}}}}\n")
    assert f"as in parent: {above};" in hint_of(raised.value.errors[0])


NODES = ("square: {motion: constant_velocity, fuse: product}", "motion: {parent: square, agent: motion}")


@pytest.mark.parametrize(
    ("columns", "found", "hint"),
    [
        ((6, 4), "7:5: square: unknown key 'motion'", A_NODE),
        ((6, 2), "7:11: motion: key 'nodes' is missing", A_NODE),
        ((6, 0), "7:1: graph: unknown key 'motion'", A_NODE),
        (
            (4, 4),
            "5:5: square: key 'nodes' is missing",
            "`square` looks like a node: write `nodes:` above it and indent the nodes under it",
        ),
    ],
)
def test_a_node_outside_nodes_is_one_error_with_a_hint(columns, found, hint, tmp_path):
    lines = ["bayesnet: 1", "name: g", "targets:", "  square:"]
    lines += ["    nodes:"] if columns[0] == 6 else []
    lines += [" " * column + node for column, node in zip(columns, NODES, strict=True)]
    path = tmp_path / "g.yaml"
    path.write_text("\n".join(lines))
    with pytest.raises(GraphError) as raised:
        load_graph(path)
    (only,) = raised.value.errors
    assert str(only).startswith(f"{path}:{found}; allowed: ") and hint_of(only) == hint


def test_other_slips_of_a_target_without_nodes_are_told():
    with pytest.raises(GraphError) as raised:
        read_graph("name: g\ntargets: {t: {birht: {}}}\n")
    assert [(one.found, one.nearest, hint_of(one)) for one in raised.value.errors] == [
        ("key 'nodes' is missing", "", ""),
        ("unknown key 'birht'", "birth", ""),
    ]


@pytest.mark.parametrize(
    ("adapt", "above"),
    [
        (
            "{activate: {above: {ud_px2: 9}, frames: 1}, deactivate: {below: {ud_px2: 5}}, frames: 6}",
            "deactivate",
        ),
        ("{frames: 6, activate: {above: {ud_px2: 9}}}", "activate"),
        ("{frames: 6, activate: {above: {ud_px2: 9}, frames: 1}}", None),
    ],
)
def test_a_misplaced_key_belongs_to_the_last_mapping_before_it_that_lacks_it(adapt, above):
    with pytest.raises(GraphError) as raised:
        read_graph(f"name: g\ntargets: {{t: {{nodes: {{s: {{adapt: {adapt}}}}}}}}}\n")
    hint = f"`frames` is a key of `{above}`: indent it under `{above}:`" if above else ""
    assert [hint_of(one) for one in raised.value.errors] == [hint]


def test_a_long_line_is_shown_around_the_caret(tmp_path):
    path = tmp_path / "long.yaml"
    path.write_text(f"bayesnet: 1\nname: g\nabout: {{{'x: 1, ' * 60}}}\ntargets: {{}}\n")
    with pytest.raises(GraphError) as raised:
        load_graph(path)
    shown = describe_error(raised.value).splitlines()
    caret = next(n for n, line in enumerate(shown) if line.endswith("^"))
    assert all(len(line) <= WIDTH + 12 for line in shown[caret - 1 : caret + 1])
    assert shown[caret - 1][len(shown[caret]) - 1] == "x"


def test_a_file_that_is_gone_or_no_file_has_no_excerpt(tmp_path):
    with pytest.raises(GraphError) as raised:
        load_graph(tmp_path / "none.yaml")
    assert describe_error(raised.value) == str(raised.value)
    assert hint_of(raised.value.errors[0]) == ""
