"""Calibration in graph files: what is accepted, and each message word for word."""

from __future__ import annotations

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graph.text.write import write_graph

HEAD = """bayesnet: 1
name: g
targets: {t: {nodes: {a: {parent: s, agent: motion}, s: {motion: {random_walk: {sd_px: {x: 9}}},
"""
SCORE = "score: {logistic: {bias: 1, evidence: 0.5}}"

CASES = [
    (
        "  lost: {score_below: 0.2}, localization_error: {lost_sd_box: 2}",
        "4:10: s: lost.score_below without a score that is a probability; allowed: score at the root, or no "
        "such key\n"
        "4:50: s: localization_error.lost_sd_box without a score that is a probability; allowed: score at "
        "the root, or no such key",
    ),
    (
        f"  {SCORE}, lost: {{uncertain_below: 0.2}}",
        "4:55: s: lost.uncertain_below without lost.score_below; allowed: both, or none",
    ),
    (
        f"  {SCORE}, lost: {{score_below: 0.5, uncertain_below: 0.2}}",
        "4:90: s: lost.uncertain_below is 0.2, not above lost.score_below, 0.5; allowed: above 0.5",
    ),
    (
        f"  {SCORE}, lost: {{score_below: 0.5, above: {{ud_box: 3}}}}",
        "4:73: s: lost.above has no effect: with score_below the score alone says when the target is lost; "
        "allowed: one of above, score_below",
    ),
    (
        f"  {SCORE}, localization_error: {{sd_box: 0.5, lost_sd_box: 0.25}}",
        "4:95: s: localization_error.lost_sd_box is 0.25, not above localization_error.sd_box, 0.5; allowed: "
        "above 0.5",
    ),
    (
        f"  {SCORE}, lost: {{score_below: 0.2, uncertain_below: 0.5}}, distractors: {{}}",
        "4:96: s: distractors put the score at one half, which lost.uncertain_below does not call uncertain; "
        "allowed: lost.uncertain_below above 0.5",
    ),
    (
        f"  {SCORE}, lost: {{score_below: 0.2, found_fit: 0.3}}",
        "4:73: s: lost.found_fit puts the score at one half, which lost.uncertain_below does not call "
        "uncertain; allowed: lost.uncertain_below above 0.5",
    ),
    (
        "  adapt: {activate: {above: {score: 0.3}}}",
        "4:11: s: activate can never fire: every agent here is on, and nothing switches one off; allowed: a "
        "deactivate rule, a self_check, active: false, or no such rule\n"
        "4:30: s: adapt.activate.above.score without a score that is a probability; allowed: score at the "
        "root, or no such key",
    ),
    (
        "  guarantee: {above: 0.9}",
        "4:3: s: guarantee without a score that is a probability; allowed: score at the root, or no such key",
    ),
    (
        f"  {SCORE}, alarm: {{total: 20, videos: 19}}",
        "4:75: s: alarm of 19 videos is never raised: its e-value stays below 20, and has to reach 20; "
        "allowed: more videos, or a larger share",
    ),
    (
        "  learn: {below: {ud_box: 0.5}, score_above: 0.5}",
        "4:33: s: learn.score_above without a score that is a probability; allowed: score at the root, or no "
        "such key",
    ),
    (
        "  score: {logistic: {bias: 1, verifiers: {log_fit: {agent: texture}}}}",
        "4:43: s: a verifier named 'log_fit', as something else of the score; allowed: another name",
    ),
    (
        "  score: {logistic: {bias: 1, verifiers: {v: {agent: textur}, w: {agent: {texture: {cell: 2}}}}}}",
        "4:54: s: unknown cue 'textur'; allowed: camshift, color_blobs, color_histogram, "
        "color_kernel_histogram, correlation_filter, detection, displacement, embedding, foreground_color, "
        "intensity, klt, mean_shift, ... (10 more); nearest: texture\n"
        "4:85: s: unknown key 'cell'; allowed: floor, sd_log_area, sd_log_aspect, form, cells, noise_gray, "
        "alpha_share, alpha_min; nearest: cells",
    ),
    (
        "  score: {logistic: {bias: 1, confidence: {a: 1}}}",
        "4:44: s: the confidence of 'a', which is no agent that says how sure it is; allowed: an agent such "
        "as siamese_box",
    ),
    (
        "  score: {logistic: {bias: 1, confidence: {nt: 1, c: 1}}}, fuse: product}, c: "
        "{parent: s, agent: {opencv_tracker: {tracker: MIL}}}, net: {parent: s, agent: siamese_box",
        "4:44: s: the confidence of 'nt', which is no agent that says how sure it is; allowed: net; nearest: "
        "net\n"
        "4:51: s: the confidence of 'c', which is no agent that says how sure it is; allowed: net",
    ),
    (
        "  score: {logistic: {bias: 1, verifiers: {v: {agent: klt}, w: {agent: motion}}}}",
        "4:54: s: verifier v: klt measures; allowed: a cue that scores boxes by looks\n"
        "4:71: s: verifier w: motion does not go by the target's looks; allowed: a cue that scores boxes by "
        "looks",
    ),
]


def graph(inside):
    return f"{HEAD}{inside}}}}}}}}}\n"


@pytest.mark.parametrize(("inside", "said"), CASES)
def test_messages(inside, said):
    with pytest.raises(GraphError) as error:
        check(*read_graph(graph(inside), "g"))
    assert "\n".join(str(one).removeprefix("g:") for one in error.value.errors) == said


def test_a_calibrated_graph_is_accepted_and_written_back():
    inside = f"  {SCORE}, localization_error: {{sd_box: 0.02, lost_sd_box: 2}}, lost: {{score_below: 0.2}}"
    spec, at = read_graph(graph(inside).replace("agent: motion", "agent: motion, temperature: 1.7"))
    assert read_graph(check(spec, at).text)[0] == spec
    assert "temperature: 1.7" in write_graph(spec)


@pytest.mark.parametrize("wrong", ["0", "-1", ".nan"])
def test_a_temperature_is_above_zero(wrong):
    with pytest.raises(GraphError, match="temperature is"):
        read_graph(graph(f"  {SCORE}").replace("agent: motion", f"agent: motion, temperature: {wrong}"))


def test_score_belongs_to_the_root():
    text = graph(f"  {SCORE}").replace(
        "a: {parent: s", "b: {parent: s, localization_error: {}}, a: {parent: b"
    )
    with pytest.raises(GraphError, match="key 'localization_error' below the root"):
        check(*read_graph(text))
