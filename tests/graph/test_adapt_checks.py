"""Adaptation by evidence in graph files: what is accepted, and each message word for word."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

HEAD = """bayesnet: 1
name: g
targets: {t: {nodes: {a: {parent: s, agent: motion}, b: {parent: s, agent: intensity}, s: {fuse: product,
  motion: {random_walk: {sd_px: {x: 9}}},
"""

CASES = [
    (
        "  adapt: {activate: {frames: 3}}",
        '5:21: s: activate is {"frames": 3}; allowed: exactly one of above, unless',
    ),
    (
        "  adapt: {deactivate: {below: {ud_px2: 9}, when: concentrated}}",
        '5:23: s: deactivate is {"below": {"ud_px2": 9}, "when": "concentrated"}; '
        "allowed: exactly one of below, when",
    ),
    (
        "  adapt: {activate: {unless: concentratd}}",
        "5:22: s: unknown unless 'concentratd'; allowed: concentrated; nearest: concentrated",
    ),
    (
        "  adapt: {activate: {unless: {concentrated: {share: 1, confidence: 0.4}}}}",
        "5:53: s: share is 1; allowed: a number above 0, below 1\n"
        "5:68: s: confidence is 0.4; allowed: a number at least 0.5, below 1",
    ),
    (
        "  adapt: {activate: {unless: {concentrated: {share: 0.9}}},\n"
        "    deactivate: {when: {concentrated: {share: 0.8, within_box: 0.5}}}}",
        "6:47: s: adapt.deactivate.when: share is 0.8, and 0.9 in adapt.activate.unless: both rules "
        "could hold "
        "at once; allowed: at least 0.9\n"
        "6:64: s: adapt.deactivate.when: within_box is 0.5, and 0.25 in adapt.activate.unless: both "
        "rules could "
        "hold at once; allowed: at most 0.25",
    ),
    (
        "  adapt: {activate: {unless: {concentrated: {confidence: 0.99}}}, deactivate: {when: concentrated}}",
        "5:86: s: adapt.deactivate.when: confidence is 0.95 by default, and 0.99 in "
        "adapt.activate.unless: both "
        "rules could hold at once; allowed: at least 0.99",
    ),
    (
        "  adapt: {deactivate: {when: concentrated}, information: {memory_frames: 9}}",
        "5:45: s: information has no effect: no rule here goes by it; "
        "allowed: which: information_per_ms, drop: min_information_per_ms, or no such key",
    ),
    (
        "  adapt: {deactivate: {when: concentrated, drop: min_information_per_ms}, information: "
        "{exploration: 9}}",
        "5:89: s: exploration has no effect: only which: information_per_ms hopes for the unknown; "
        "allowed: which: information_per_ms, or no exploration",
    ),
    (
        "  adapt: {agents: [a, a, bb], deactivate: {when: concentrated}}",
        "5:23: s: agents names 'a' twice; allowed: b\n"
        "5:26: s: agents names 'bb', which is no agent below s; allowed: b; nearest: b",
    ),
    (
        "  adapt: {agents: [s], deactivate: {when: concentrated}}",
        "5:20: s: agents names 's', which is no agent below s; allowed: a, b",
    ),
    (
        "  adapt: {agents: [], deactivate: {when: concentrated}}",
        "5:19: s: agents is empty; allowed: at least one",
    ),
    (
        "  adapt: {agents: [a], deactivate: {when: concentrated}, keep: 2}",
        "5:24: s: deactivate can never fire: keep is 2 of 2 agents; "
        "allowed: more agents, a smaller keep, or no such rule",
    ),
    (
        "  adapt: {agents: [a], activate: {above: {ud_px2: 9}}}",
        "5:24: s: activate can never fire: every agent here is on, and nothing switches one off; "
        "allowed: a deactivate rule, a self_check, active: false, or no such rule",
    ),
    (
        "  adapt: {agents: [a], deactivate: {when: concentrated}}},\n"
        "  part: {parent: s, fuse: {latent: {given: {sd_px: {x: 1}}}}, adapt: {agents: [c, a],\n"
        "    deactivate: {when: concentrated}, keep: 1}}, c: {parent: part, agent: texture},\n"
        "  d: {parent: part, agent: shape",
        "6:83: part: agents names 'a', which is no agent below part; allowed: d",
    ),
    (
        "  adapt: {agents: [a, c], deactivate: {when: concentrated}}},\n"
        "  part: {parent: s, fuse: {latent: {given: {sd_px: {x: 1}}}}, adapt: {agents: [c],\n"
        "    deactivate: {when: concentrated}}}, c: {parent: part, agent: texture},\n"
        "  d: {parent: part, agent: shape",
        "5:23: s: agents names 'c', which the rules of part switch; allowed: b, d",
    ),
    (
        "  learn: {below: {ud_px2: 9}, guard: {apart_nats: 0, pull: 2}}",
        "5:51: s: apart_nats is 0; allowed: a number above 0\n"
        "5:60: s: pull is 2; allowed: a number at least 0, at most 1",
    ),
    (
        "  adapt: {agents: [a], on_call: {every: 4, above: {ud_box: 1}}, activate: {above: {ud_box: 1}}}",
        "5:24: s: on_call beside activate: agents on call stay on; allowed: one or the other",
    ),
    (
        "  adapt: {on_call: {every: 4, above: {ud_box: 1}}}",
        "5:11: s: on_call leaves no agent that runs in every frame, and could call the others; "
        "allowed: agents: [...] with some of them",
    ),
    (
        "  adapt: {agents: [a], on_call: {every: 4, above: {ud_box: 1}}},\n"
        "  learn: {below: {ud_box: 0.1}, every: 2}",
        "6:33: s: learn.every has no effect beside on_call: references learn where the agents on call run; "
        "allowed: no learn.every",
    ),
    (
        "  adapt: {agents: [a], keep: 2, on_call: {every: 4, above: {ud_box: 1}}}",
        "5:24: s: keep has no effect: agents on call stay on; allowed: no keep",
    ),
    (
        "  adapt: {activate: {above: {ud_box: 1}}, deactivate: {below: {ud_box: 0.5}}}},\n"
        "  part: {parent: s, fuse: {latent: {given: {sd_px: {x: 1}}}}, adapt: {agents: [c],\n"
        "    on_call: {every: 4, above: {ud_box: 1}}}}, c: {parent: part, agent: texture},\n"
        "  d: {parent: part, agent: shape",
        "7:5: part: on_call at part, which is below s; allowed: on_call at the root",
    ),
    (
        "  adapt: {agents: [d], on_call: {every: 4, above: {ud_box: 1}}}},\n"
        "  d: {parent: s, agent: shape, active: false",
        "6:40: d: active: false, and nothing switches on an agent on call; allowed: active: true",
    ),
    (
        "  adapt: {agents: [a], on_call: {every: 1, agree: 1, above: {ud_box: 0}}}",
        "5:41: s: every is 1; allowed: a whole number at least 2, at most 1000\n"
        "5:51: s: agree is 1; allowed: a number above 0, below 1\n"
        "5:70: s: ud_box is 0; allowed: a number above 0",
    ),
    (
        "  adapt: {agents: [a], on_call: {every: 4}}",
        "5:33: s: key 'above' is missing; allowed: one of ud_px2, ud_box, ud_baseline",
    ),
]


@pytest.mark.parametrize(("text", "said"), CASES)
def test_each_message(text, said):
    with pytest.raises(GraphError) as error:
        check(*read_graph(f"{HEAD}{text}\n}}}}}}}}", "g.yaml"))
    lines = [str(message).removeprefix("g.yaml:") for message in error.value.errors]
    assert lines == said.splitlines()


@pytest.mark.parametrize(
    "text",
    [
        "  adapt: {activate: {unless: concentrated}, deactivate: {when: concentrated}}",
        "  adapt: {agents: [a], on_call: {every: 4, agree: 0.5, above: {ud_baseline: 2}}}",
        "  adapt: {activate: {above: {ud_box: 1}}, deactivate: {when: {concentrated: {share: 0.5}}}}",
        "  adapt: {activate: {unless: concentrated, which: information_per_ms},\n"
        "    deactivate: {when: {concentrated: {share: 0.95, within_box: 0.2}}}, information: "
        "{exploration: 0.3}}",
        "  learn: {below: {ud_px2: 9}, guard: {}}",
        "  adapt: {agents: [a], deactivate: {when: concentrated}}",
    ],
)
def test_what_is_accepted(text):
    check(*read_graph(f"{HEAD}{text}\n}}}}}}}}", "g.yaml"))
