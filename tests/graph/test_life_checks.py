"""What is refused of the keys that say how targets are born, recognised and end."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graph.text.read import read_graph

HEAD = "bayesnet: 1\nname: g\ntargets:\n  t:\n"
NODES = """
    nodes:
      s: {motion: {random_walk: {sd_px: {x: 9}}}}
      a: {parent: s, agent: hue}
"""


def errors_of(life, cues):
    with pytest.raises(GraphError) as caught:
        spec, at = read_graph(HEAD + life + NODES, "g.yaml")
        check(spec, at, cues)
    return str(caught.value)


@pytest.mark.parametrize(
    ("life", "said"),
    [
        (
            "    birth: {detector: {backgroud: {min_area_px: 2}}}",
            ["g.yaml:5:24: t: unknown detector 'backgroud'; allowed: ", "; nearest: background"],
        ),
        ("    birth: {detector: {detector: motion}}", ["g.yaml:5:24: t: unknown detector 'detector'"]),
        (
            "    birth: {detector: {background: {min_area: 2}}}",
            ["g.yaml:5:37: t: unknown key 'min_area'", "; nearest: min_area_px"],
        ),
        (
            "    birth: {detector: {detections: {min_score: 2}}}",
            ["g.yaml:5:48: t: min_score is 2; allowed: a number at least 0, at most 1"],
        ),
        (
            "    birth: {detector: motion, confirm: {hits: 5, of: 4}}",
            ["g.yaml:5:40: t: confirm is ", "no more hits than `of`: 5 of 4"],
        ),
        ("    birth: {every: 2}", ["g.yaml:5:12: t: key 'detector' is missing; allowed: a detector, or one"]),
        ("    birth: {detector: {motion: {}, background: {}}}", ["allowed: exactly one detector"]),
        ("    reidentify: {frames: 20}", ["g.yaml:5:5: t: reidentify without birth"]),
    ],
)
def test_refusals_name_place_and_what_is_allowed(life, said, cues):
    text = errors_of(life, cues)
    for part in said:
        assert part in text


def test_defaults_are_filled_in_where_targets_are_born(cues):
    from bayesnet_track.graph.settings.lifecycle import (
        Death,
        LifeRules,
        MergeDuplicates,
        Reidentify,
        life_rules,
    )
    from bayesnet_track.graph.spec import Birth

    birth = Birth(detector="detections")
    assert life_rules(None, None, None, None) is None
    assert life_rules(birth, None, None, None) == LifeRules(birth, MergeDuplicates(), Death(), Reidentify())
    assert life_rules(None, None, Death(lost_frames=3), None) == LifeRules(
        None, None, Death(lost_frames=3), None
    )
