"""Renamed words: each gets an error that names the new one, and a recorded graph with it is still read."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graph.text.read import read_graph
from bayesnet_track.graph.text.recorded import recorded_text
from bayesnet_track.graph.text.renamed import RENAMED

# Old word -> where it stands in the graph below, and the message from line and column on.
PLATE = "    {}\n    nodes:\n      s: {{motion: random_walk}}\n"
NODE = "    nodes:\n      s: {{motion: random_walk, {}}}\n"
MOTION = "    nodes:\n      s: {{motion: {{random_walk: {{{}}}}}}}\n"
AGENT = "    nodes:\n      s: {{motion: random_walk}}\n      a: {{parent: s, agent: {{{}}}}}\n"
DROP = "adapt: {{deactivate: {{below: {{ud_px2: 9}}, drop: {}}}}}"
WRITTEN = {
    "Target.recall": (PLATE, "recall: {frames: 9}", "5:5: t: key 'recall'"),
    "Target.duplicates": (PLATE, "duplicates: {frames: 9}", "5:5: t: key 'duplicates'"),
    "Birth.most": (PLATE, "birth: {detector: motion, most: 9}", "5:31: t: key 'most'"),
    "Birth.apart_box": (PLATE, "birth: {detector: motion, apart_box: 1}", "5:31: t: key 'apart_box'"),
    "Birth.covered": (PLATE, "birth: {detector: motion, covered: 1}", "5:31: t: key 'covered'"),
    "Confirm.looks": (PLATE, "birth: {detector: motion, confirm: {looks: 2}}", "5:41: t: key 'looks'"),
    "Reidentify.least_probability": (
        PLATE,
        "reidentify: {least_probability: 1}",
        "5:18: t: key 'least_probability'",
    ),
    "InferenceNode.slack": (NODE, "slack: {sd_box: 1}", "6:32: s: key 'slack'"),
    "InferenceNode.rivals": (NODE, "rivals: {hold: 1}", "6:32: s: key 'rivals'"),
    "Particles.importance": (
        NODE,
        "belief: {particles: {importance: auxiliary}}",
        "6:53: s: key 'importance'",
    ),
    "Proposal.regular": (NODE, "belief: {particles: {proposal: regular}}", "6:53: s: proposal 'regular'"),
    "Proposal.adaptive": (NODE, "belief: {particles: {proposal: adaptive}}", "6:53: s: proposal 'adaptive'"),
    "Proposal.rejection": (
        NODE,
        "belief: {particles: {proposal: {rejection: {rounds: 3}}}}",
        "6:64: s: proposal 'rejection'",
    ),
    "Proposal.west": (NODE, "belief: {particles: {proposal: {west: {}}}}", "6:64: s: proposal 'west'"),
    "Estimate.best": (NODE, "estimate: best", "6:32: s: estimate 'best'"),
    "Noise.wide": (MOTION, "wide: {weight: 0.1, factor: 2}", "6:34: s: key 'wide'"),
    "HeavyTail.share": (MOTION, "heavy_tail: {share: 0.1, factor: 2}", "6:47: s: key 'share'"),
    "Moving.widen": (MOTION, "widen: {}", "6:34: s: key 'widen'"),
    "Moving.keep_size": (MOTION, "keep_size: {sd_scale: 1}", "6:34: s: key 'keep_size'"),
    "Moving.recover": (MOTION, "recover: {share: 0.1}", "6:34: s: key 'recover'"),
    "Inflate.most": (MOTION, "inflate: {most: 2}", "6:44: s: key 'most'"),
    "Probes.most": (MOTION, "relocalize: {by: {agents: {most: 20}}}", "6:61: s: key 'most'"),
    "Level.ud_quiet": (NODE, "learn: {below: {ud_quiet: 2}}", "6:48: s: below 'ud_quiet'"),
    "Deactivate.glance": (
        NODE,
        "adapt: {deactivate: {below: {ud_px2: 9}, glance: 3}}",
        "6:73: s: key 'glance'",
    ),
    "Information.memory": (NODE, "adapt: {information: {memory: 3}}", "6:54: s: key 'memory'"),
    "Information.explore": (NODE, "adapt: {information: {explore: 3}}", "6:54: s: key 'explore'"),
    "Logistic.memory": (NODE, "score: {logistic: {bias: 0, memory: 3}}", "6:60: s: key 'memory'"),
    "detection.least_overlap": (AGENT, "detection: {least_overlap: 0.1}", "7:42: a: key 'least_overlap'"),
    "detection.looks": (AGENT, "detection: {looks: 0.1}", "7:42: a: key 'looks'"),
    "displacement.least_seen": (AGENT, "displacement: {least_seen: 0.1}", "7:45: a: key 'least_seen'"),
    "klt.least_correlation": (AGENT, "klt: {least_correlation: 0.1}", "7:36: a: key 'least_correlation'"),
    "klt.least_seen": (AGENT, "klt: {least_seen: 0.1}", "7:36: a: key 'least_seen'"),
    "klt.most_scale": (AGENT, "klt: {most_scale: 2}", "7:36: a: key 'most_scale'"),
    "opencv_tracker.least_correlation": (
        AGENT,
        "opencv_tracker: {least_correlation: 0.1}",
        "7:47: a: key 'least_correlation'",
    ),
} | {
    key: (NODE, DROP.format(key.rsplit(".", 1)[1]), f"6:79: s: drop {key.rsplit('.', 1)[1]!r}")
    for key in RENAMED
    if key.startswith("Deactivate.drop.")
}


def old_graph(old: str) -> str:
    place, words, _ = WRITTEN[old]
    return "bayesnet: 1\nname: g\ntargets:\n  t:\n" + place.format(words)


def test_every_renamed_word_has_a_case() -> None:
    assert WRITTEN.keys() == RENAMED.keys()


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_word_gets_an_error_that_names_the_new_one(old: str) -> None:
    with pytest.raises(GraphError) as error:
        check(*read_graph(old_graph(old), "g.yaml"))
    said = [line for line in str(error.value).splitlines() if "renamed" in line]
    assert said == [f"g.yaml:{WRITTEN[old][2]} has been renamed; allowed: {RENAMED[old]}"]


@pytest.mark.parametrize("old", RENAMED)
def test_a_recorded_graph_with_an_old_word_is_read_as_one_with_the_new(old: str) -> None:
    word, new = old.rsplit(".", 1)[1], RENAMED[old]
    text = old_graph(old)
    assert text.count(f"{word}") == 1
    expected, _ = read_graph(text.replace(word, new), "g.yaml")
    assert read_graph(recorded_text(text), "g.yaml")[0] == expected


def test_a_recorded_graph_without_old_words_keeps_every_byte() -> None:
    text = "bayesnet: 1   # as it was\nname: g\ntargets: {t: {nodes: {s: {motion: random_walk}}}}\n"
    assert recorded_text(text) == text
    assert recorded_text("name: [") == "name: ["
