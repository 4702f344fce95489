"""Estimates of `fit` that change the tracking: sds of cues, activation policy, correlation of pools.

They are written into the graph before its score, regions and levels are fitted, which depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import complain, users_mistake
from bayesnet_track.cli.fitting.videos import Video, frames_of
from bayesnet_track.journal.text.wording import plural

if TYPE_CHECKING:
    from bayesnet_track.evaluate.cue_parameters import FittedSd
    from bayesnet_track.evaluate.policies import Chosen, Policy, Trial
    from bayesnet_track.graph.checked import CheckedGraph


def check_text(text: str, name: str) -> CheckedGraph:
    """Check a graph's text, as a run of it would; raises GraphError."""
    from bayesnet_track.graph.checks.run import check
    from bayesnet_track.graph.text.load import read_graph

    return check(*read_graph(text, name))


def fit_sds(text: str, graph: CheckedGraph, videos: Sequence[Video], end: int | None) -> str:
    """The graph's text with the standard deviations of its cues."""
    from bayesnet_track.evaluate.cue_parameters import MEMORY_FRAMES, cue_residuals
    from bayesnet_track.evaluate.cue_parameters import fit_sds as estimate

    found = []
    for video in videos:
        with frames_of(video, end) as frames, users_mistake():
            found.append(cue_residuals(graph, frames, video.truth))
    with users_mistake():
        fitted = estimate(found)
    for (agent, parameter), one in fitted.items():
        complain(
            f"{agent}, {parameter}: {one.value:.3g} from {one.residuals} residuals; central 50 % and 90 % "
            f"of such a Gaussian hold {_shares(one.inside)}; {_shares(one.left_out)} of videos left out, and "
            f"{_shares(one.followed)} with sd_memory_frames: {MEMORY_FRAMES:g}"
        )
    return write_sds(text, graph, fitted, len(videos))


def _shares(inside: tuple[float, float]) -> str:
    return " and ".join(f"{100 * share:.0f} %" for share in inside)


def write_sds(text: str, graph: CheckedGraph, fitted: Mapping[tuple[str, str], FittedSd], videos: int) -> str:
    """The graph's text with fitted standard deviations, each agent's with a comment that says from what."""
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    for agent in dict.fromkeys(agent for agent, _ in fitted):
        chosen = plate.agent(agent).agent
        own = {key[1]: one for key, one in fitted.items() if key[0] == agent}
        count = max(one.residuals for one in own.values())
        comment = f"{', '.join(own)}: residuals at true boxes, {count} in {plural(videos, 'video')}"
        values = {parameter: float(f"{one.value:.3g}") for parameter, one in own.items()}
        where = ("targets", name, "nodes", agent, "agent")
        if chosen.parameters:
            for parameter, value in values.items():
                text = set_value(text, (*where, chosen.plugin, parameter), value, comment)
        else:
            text = set_value(text, where, {chosen.plugin: values}, comment)
    return text


def fit_policy(text: str, graph: CheckedGraph, videos: Sequence[Video], end: int | None, seeds: int) -> str:
    """The graph's text with the activation policy that is chosen on `videos`."""
    import numpy as np

    from bayesnet_track.evaluate.calibration_data import calibration_data, with_features
    from bayesnet_track.evaluate.policies import Trial, candidates, policy_of, search
    from bayesnet_track.evaluate.scores import success_auc

    plate = next(iter(graph.targets.values()))
    rules = plate.inference(plate.root).adapt
    with users_mistake():
        own = policy_of(rules)

    def run(policy: Policy, number: int) -> Trial:
        video, trials = videos[number], []
        measuring = with_features(check_text(write_policy(text, graph, policy), "a candidate"))
        for seed in range(seeds):
            with frames_of(video, end) as frames, users_mistake():
                one = calibration_data(measuring, video.name, frames, video.truth, seed)
            trials.append((success_auc(one.iou[one.seen]), one.cost_ms))
        auc, cost = np.mean(trials, axis=0)
        complain(f"{video.name}, {_describe(policy)}: AUC {auc:.3f}, {cost:.2f} ms")
        return Trial(float(auc), float(cost))

    with users_mistake():
        chosen = search(candidates(own), len(videos), run)
    complain(_summary(chosen))
    comment = (
        f"AUC {chosen.trial.auc:.3f}, before {chosen.own.auc:.3f}; declared {chosen.trial.cost_ms:.2f} ms, "
        f"before {chosen.own.cost_ms:.2f}; {plural(len(videos), 'video')}"
    )
    return write_policy(text, graph, chosen.policy, comment)


def write_policy(text: str, graph: CheckedGraph, policy: Policy, comment: str = "") -> str:
    """The graph's text with an activation policy."""
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    adapt = plate.inference(plate.root).adapt
    assert adapt is not None and adapt.activate is not None and adapt.activate.above is not None
    kind, where = adapt.activate.above.kind, ("targets", name, "nodes", plate.root, "adapt")
    text = set_value(text, (*where, "activate", "above"), {kind: policy.activate}, comment)
    text = set_value(text, (*where, "deactivate", "below"), {kind: policy.deactivate}, comment)
    if policy.sample_every is not None:
        text = set_value(text, (*where, "deactivate", "sample_every"), policy.sample_every, comment)
    return text


def _describe(policy: Policy) -> str:
    sample_every = "" if policy.sample_every is None else f", sample_every {policy.sample_every}"
    return f"on above {policy.activate:g}, off below {policy.deactivate:g}{sample_every}"


def _summary(chosen: Chosen) -> str:
    return (
        f"policy: {_describe(chosen.policy)}; chosen from {chosen.candidates} in {chosen.runs} trials: AUC "
        f"{chosen.trial.auc:.3f} (the graph's own {chosen.own.auc:.3f}), declared cost "
        f"{chosen.trial.cost_ms:.2f} ms a frame (own {chosen.own.cost_ms:.2f})"
    )


def fit_fusion(text: str, graph: CheckedGraph, videos: Sequence[Video], end: int | None) -> str:
    """The graph's text with the `correlation` of every learned pool."""
    from bayesnet_track.evaluate.cue_parameters import fit_correlation, learned_pools, pool_errors
    from bayesnet_track.graph.settings.net import pool_exponents
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    with users_mistake():
        pools = learned_pools(plate)
    found = []
    for video in videos:
        with frames_of(video, end) as frames, users_mistake():
            found.append(pool_errors(graph, frames, video.truth))
    for pool, children in pools.items():
        with users_mistake():
            fitted = fit_correlation([one[pool] for one in found])
        value = float(f"{fitted.value:.3g}")
        exponent = next(iter(pool_exponents(dict.fromkeys(children, 1.0), value).values()))
        low, high = fitted.without
        complain(
            f"{pool}: errors correlated by {value:g} ({low:.2f} to {high:.2f} without one video), from "
            f"{plural(fitted.frames, 'frame')}; each of {len(children)} children counts {exponent:.2f}"
        )
        comment = f"errors at true boxes, {fitted.frames} frames of {plural(len(videos), 'video')}"
        text = set_value(text, ("targets", name, "nodes", pool, "correlation"), value, comment)
    return text
