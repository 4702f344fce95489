"""What is refused of `joins`, with its place."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.spec import Join
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

HEAD = """bayesnet: 1
name: g
targets:
  person: {nodes: {p: {motion: {random_walk: {sd_px: {x: 9}}}}, a: {parent: p, agent: hue}}}
  box: {nodes: {b: {belief: %s, motion: {random_walk: {sd_px: {x: 9}}}}, a: {parent: b, agent: hue}}}
joins:
"""


@pytest.mark.parametrize(
    ("belief", "joins", "said"),
    [
        ("particles", "  - {between: [person, bx], exclusion: {}}",
         "g.yaml:7:24: graph: no kind of target 'bx'; "
         "allowed: person, box; nearest: box"),
        ("particles", "  - {between: [person, box]}",
         "allowed: at least one of exclusion, occlusion, attachment, factor"),
        ("particles", "  - {exclusion: {nats: -1}}", "g.yaml:7:24: graph: nats is -1"),
        ("particles", "  - {occlusion: {stay: 0.4}}", "stay is 0.4; allowed: a number at least 0.5, below 1"),
        ("particles", "  - {attachment: {}}",
         "g.yaml:7:6: graph: attachment without a carrier's and a carried kind"),
        ("particles", "  - {exclusion: {}}\n  - {between: [box, person], occlusion: {}}",
         "g.yaml:8:5: graph: a second join between person and box; allowed: one, as in entry 1"),
        ("gaussian", "  - {between: [person, box], exclusion: {}}",
         "g.yaml:7:5: graph: a join of box, whose node b holds a gaussian belief"),
        ("grid", "  - {exclusion: {}}", "graph: a join of box, whose node b holds a grid belief"),
        ("particles", "  - {exclusion: {}, whn: {}}", "unknown key 'whn'"),
        ("particles", "  - {between: [person, box], factor: normal(a.x - b.z)}",
         "g.yaml:7:51: graph: unknown name 'b.z'; allowed: a.x, a.y, a.w, a.h, b.x"),
        ("particles", '  - {between: [person, box], factor: "normal(a.x - b.x, 40)"}',
         "normal with 2 arguments"),
        ("particles", "  - {between: [person, box], factor: normal(x)}", "unknown name 'x'; allowed: a.x"),
        ("particles", "  - {between: [person, box], factor: a.x * dt}", "unknown name 'dt'"),
        ("particles", "  - {between: [person, box], factor: a.x + }", "where the expression goes on"),
        ("particles", "  - {factor: a.x}", "factor without between; allowed: between: [a, b]"),
        ("particles", "  - {between: [person, box], factor: a.x, exclusion: {}}",
         "factor beside exclusion; allowed: either of them"),
        ("particles", "  - {between: [person, box], factor: a.x, attachment: {}}",
         "factor beside attachment"),
        ("particles", "  - {between: [person, box], factor: 5}", "factor is 5; allowed: text"),
        ("particles", "  - {exclusion: {}, when: {overlap: 0}}", "overlap 0, which joins all targets"),
        ("gaussian", "  - {between: [person, box], factor: a.x}", "holds a gaussian belief"),
    ],
)  # fmt: skip
def test_refusals_name_place_and_what_is_allowed(belief, joins, said, cues):
    with pytest.raises(GraphError) as caught:
        spec, at = read_graph(HEAD % belief + joins, "g.yaml")
        check(spec, at, cues)
    assert said in str(caught.value)


def test_a_join_holds_between_its_kinds():
    every = Join.model_validate({"exclusion": {}})
    own = Join.model_validate({"between": ["disc"], "exclusion": {}})
    two = Join.model_validate({"between": ["person", "box"], "exclusion": {}})
    assert every.holds_between("a", "b") and every.holds_between("a", "a")
    assert own.holds_between("disc", "disc") and not own.holds_between("disc", "box")
    assert two.holds_between("box", "person") and not two.holds_between("box", "box")
    assert not two.holds_between("person", "other")


def test_without_occlusion_the_order_has_no_memory():
    assert Join.model_validate({"exclusion": {"nats": 2}}).stay == 0.5
    assert Join.model_validate({"occlusion": {}}).stay == 0.95
    assert not Join.model_validate({"between": ["a", "b"], "attachment": {}}).shares_pixels
