"""What is refused of the keys that say how targets are born, recognised and end."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

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
        ("    merge_duplicates: nevr", ["g.yaml:5:23: t: merge_duplicates is "]),
        (
            "    birth: {detector: motion, max_overlap: often}",
            ["g.yaml:5:44: t: max_overlap is 'often'; allowed: never or a number above 0"],
        ),
        (
            "    birth: {detector: motion, tentative: true}",
            ["g.yaml:5:31: t: tentative without an agent that is given detections; allowed: an agent: "],
        ),
        ("    reidentify: {frames: 20}", ["g.yaml:5:5: t: reidentify without birth"]),
    ],
)
def test_refusals_name_place_and_what_is_allowed(life, said, cues):
    text = errors_of(life, cues)
    for part in said:
        assert part in text


def test_defaults_are_filled_in_where_targets_are_born(cues):
    from bayesnet_track.graph.settings.lifecycle import LifeRules, life_rules
    from bayesnet_track.graph.spec import Birth, Death, MergeDuplicates, Reidentify

    birth = Birth(detector="detections")
    assert life_rules(None, None, None, None) is None
    assert life_rules(birth, None, None, None) == LifeRules(birth, MergeDuplicates(), Death(), Reidentify())
    assert life_rules(None, None, Death(lost_frames=3), None) == LifeRules(
        None, None, Death(lost_frames=3), None
    )


CROWD = """
    nodes:
      s:
        belief: {BELIEF}
        motion: {random_walk: {sd_px: {x: 9}}}
        LOST
      a: {parent: s, agent: detection}
"""
GAUSSIAN, BIRTH = (
    "gaussian: {filter: kalman, likelihood: sigma_points}",
    "    birth: {detector: detections}\n",
)


def errors_of_crowd(life, belief=GAUSSIAN, lost=""):
    nodes = CROWD.replace("BELIEF", belief).replace("LOST", lost).replace("        \n", "")
    with pytest.raises(GraphError) as caught:
        check(*read_graph(HEAD + life + nodes, "g.yaml"))
    return str(caught.value)


@pytest.mark.parametrize(
    ("life", "belief", "lost", "said"),
    [
        (
            BIRTH + "    associate: marginal",
            GAUSSIAN,
            "",
            "6:16: t: associate: marginal without existence; allowed: existence, too (existence: {}), or "
            "associate: assignment",
        ),
        (
            BIRTH + "    associate: marginal\n    existence: {}",
            "particles: {size: 100}",
            "",
            "s: associate: marginal with a belief that is not Gaussian; allowed: belief: {gaussian:",
        ),
        (
            "    birth: {detector: detections, confirm: {hits: 2}}\n    existence: {}",
            GAUSSIAN,
            "",
            "5:35: t: birth.confirm has no effect: existence.confirm says when a target is born",
        ),
        (
            BIRTH + "    existence: {end: 0.5, confirm: 0.4}",
            GAUSSIAN,
            "",
            "end below confirm: 0.5 is not below 0.4",
        ),
        (
            BIRTH + "    existence: {survival: 1.5}",
            GAUSSIAN,
            "",
            "survival is 1.5; allowed: ",
        ),
        (
            BIRTH,
            GAUSSIAN,
            "lost: {existence_below: 0.5}",
            "s: lost.existence_below without existence; allowed: existence for the target, or no such key",
        ),
        (
            BIRTH + "    existence: {end: 0.2}",
            GAUSSIAN,
            "lost: {existence_below: 0.1}",
            "s: lost.existence_below is 0.1, not above existence.end, 0.2; allowed: above 0.2",
        ),
        (
            BIRTH + "    existence: {}",
            GAUSSIAN,
            "lost: {existence_below: 0.5, fit_below: 0.1}",
            "s: lost.fit_below has no effect: with existence_below existence alone says what is lost",
        ),
        (
            BIRTH + "    existence: {}",
            GAUSSIAN,
            "lost: {existence_below: 0.5, existence_in_box_below: 0.4}",
            "s: lost.existence_below has no effect: with existence_in_box_below existence alone",
        ),
        (BIRTH + "    associate: jpda", GAUSSIAN, "", "associate is 'jpda'; allowed: "),
    ],
)
def test_existence_and_association_stand_beside_what_they_need(life, belief, lost, said):
    assert said in errors_of_crowd(life, belief, lost)


def test_existence_needs_births_and_an_agent_that_measures_by_detections(cues):
    text = errors_of("    existence: {}", cues)
    assert "g.yaml:5:5: t: existence without birth; allowed: birth, too, or no such key" in text
    assert "existence without an agent that measures by detections" in text


def test_a_gap_is_not_filtered_anew_in_modes():
    modes = "modes: {seen: {mean_frames: 40}, behind: {mean_frames: 9, hidden: {}}}"
    text = (
        HEAD
        + """    birth: {detector: detections}
    nodes:
      s: {belief: {gaussian: {filter: kalman}}, motion: {random_walk: {sd_px: {x: 9}}}, MODES}
      a: {parent: s, agent: {detection: {re_update: true}}}
""".replace("MODES", modes)
    )
    with pytest.raises(GraphError) as caught:
        check(*read_graph(text, "g.yaml"))
    said = "a: modes of s beside re_update, which filters a gap anew in one mode; allowed: no re_update"
    assert said in str(caught.value)
