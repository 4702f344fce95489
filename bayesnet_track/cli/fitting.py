"""Estimates of `fit`: motion, sds of cues, the activation policy, and the videos that they are from.

They are written into the graph before its score, regions and levels are fitted, which depend on them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import (
    TRUTH_LINES,
    UsageError,
    complain,
    pixels,
    users_file,
    users_mistake,
)
from bayesnet_track.journal.text.wording import plural

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayesnet_track.evaluate.cue_parameters import FittedSd
    from bayesnet_track.evaluate.motion_fit import FittedMotion, FittedParameter
    from bayesnet_track.evaluate.policies import Chosen, Policy, Trial
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.observation.planes import Frame

    Tracks = Sequence[NDArray[np.float64]]


def fit_motion_text(text: str, graph: CheckedGraph, options: argparse.Namespace) -> tuple[str, str]:
    """The graph's text with the fitted motion, and what it was fitted to; prints each estimate.

    Raises:
        UsageError: options that do not go with it, no boxes, or a motion that cannot be fitted.
    """
    from bayesnet_track.evaluate.motion_fit import fit_motion

    for name in ("what", "guarantee", "alarm", "leave_one_out"):
        if getattr(options, name):
            raise UsageError(f"--motion fits the motion alone; call --{name.replace('_', '-')} separately")
    tracks = tracks_of(options)
    name, plate = next(iter(graph.targets.items()))
    with users_mistake():
        fitted = fit_motion(plate.inference(plate.root), tracks, options.box_sd)
    from_what = f"{plural(fitted.frames, 'frame')} of {plural(len(tracks), 'track')}"
    for line in _describe_motion(fitted):
        complain(line)
    return write_motion(text, ("targets", name, "nodes", plate.root), fitted.estimates, from_what), from_what


def tracks_of(options: argparse.Namespace) -> Tracks:
    """(T, 4) centre boxes of each track of `--truth` and `--folder`, up to `--end`."""
    import numpy as np

    from bayesnet_track.evaluate.truth import is_mot, read_mot_tracks, read_truth
    from bayesnet_track.numerics.boxes import centre_from_corner

    files = [Path(file) for file in options.truth]
    if options.folder is not None:
        files += sorted(Path(options.folder).glob("*/groundtruth.txt"))
    if not files:
        raise UsageError("--motion reads boxes and no images: give --truth FILE, or --folder")
    boxes_of_tracks = []
    for file in files:
        with users_file("--truth", f"{TRUTH_LINES}, or MOT lines"):
            if not is_mot(file, options.truth_format):
                boxes_of_tracks.append(
                    centre_from_corner(read_truth(file, options.truth_format))[: options.end]
                )
                continue
            tracks = read_mot_tracks(file)
        for identity in np.unique(tracks.ids):
            of_track = tracks.ids == identity
            frames = tracks.frames[of_track] - tracks.frames[of_track].min()
            boxes = np.full((frames.max() + 1, 4), np.nan)
            boxes[frames] = centre_from_corner(tracks.boxes[of_track])
            boxes_of_tracks.append(boxes[: options.end])
    return boxes_of_tracks


def _describe_motion(fitted: FittedMotion) -> list[str]:
    """A line for each estimate, and what it gains."""
    lines = [_line(parameter) for parameter in fitted.estimates]
    gain = fitted.log_evidence - fitted.log_evidence_before
    lines.append(
        f"log-evidence {fitted.log_evidence:.1f}, {gain:.1f} above that of the graph's own values, in "
        f"{plural(fitted.frames, 'frame')}"
    )
    return lines


def _line(parameter: FittedParameter) -> str:
    name, graph_value = ".".join(parameter.path), parameter.graph_value
    remark, previous_value = f"; the graph's {graph_value:g} stays", f"; before {graph_value:g}"
    if graph_value != graph_value:
        name, remark, previous_value = f"error of the boxes' {parameter.path[-1]}", "", ""
    if not parameter.is_known:
        return f"{name}: the boxes do not tell; best {parameter.value:.3g}{remark}"
    interval = f"90 % interval {parameter.low:.3g} to {parameter.high:.3g}"
    return f"{name}: {parameter.value:.3g}, {interval}{previous_value}"


def write_motion(
    text: str, node: tuple[str, ...], estimates: Sequence[FittedParameter], from_what: str
) -> str:
    """The graph's text with the estimates that the boxes tell, each with its interval as a comment."""
    from bayesnet_track.graph.text.change import set_value

    for parameter in estimates:
        if not parameter.is_known or parameter.graph_value != parameter.graph_value:
            continue
        value = float(f"{parameter.value:.3g}")
        interval = f"{parameter.low:.3g} to {parameter.high:.3g} (90 %)"
        comment = f"{parameter.path[-1]} {interval}, by evidence; {from_what}"
        try:
            text = set_value(text, (*node, *parameter.path), value, comment)
        except KeyError:  # `motion: constant_velocity`, all defaults
            text = set_value(
                text,
                (*node, *parameter.path[:-2]),
                {parameter.path[-2]: {parameter.path[-1]: value}},
                comment,
            )
    return text


def add_motion(fit: argparse.ArgumentParser) -> None:
    """`--motion` and `--box-sd`."""
    fit.add_argument(
        "--motion",
        action="store_true",
        help="fit, instead of --what, the noise and modes of the motion by maximum evidence of the boxes of "
        "--truth (no video is needed), with 90 %% intervals",
    )
    fit.add_argument(
        "--box-sd",
        type=pixels,
        metavar="PX",
        help="with --motion: sd of the boxes' errors (default: fitted, too)",
    )


def check_text(text: str, name: str) -> CheckedGraph:
    """Check a graph's text, as a run of it would; raises GraphError."""
    from bayesnet_track.graph.checks.run import check
    from bayesnet_track.graph.text.load import read_graph

    return check(*read_graph(text, name))


def fit_cue_sds(text: str, graph: CheckedGraph, videos: Sequence[AnnotatedVideo], end: int | None) -> str:
    """The graph's text with the standard deviations of its cues."""
    from bayesnet_track.evaluate.cue_parameters import MEMORY_FRAMES, cue_residuals
    from bayesnet_track.evaluate.cue_parameters import fit_sds as estimate

    residuals = []
    for video in videos:
        with frames_before(video, end) as frames, users_mistake():
            residuals.append(cue_residuals(graph, frames, video.truth))
    with users_mistake():
        fitted = estimate(residuals)
    for (agent, parameter), estimated in fitted.items():
        complain(
            f"{agent}, {parameter}: {estimated.value:.3g} from {estimated.residuals} residuals; "
            f"central 50 % and 90 % of such a Gaussian hold {_shares(estimated.inside)}; "
            f"{_shares(estimated.left_out)} of videos left out, and "
            f"{_shares(estimated.followed)} with sd_memory_frames: {MEMORY_FRAMES:g}"
        )
    return write_sds(text, graph, fitted, len(videos))


def _shares(shares: tuple[float, float]) -> str:
    return " and ".join(f"{100 * share:.0f} %" for share in shares)


def write_sds(text: str, graph: CheckedGraph, fitted: Mapping[tuple[str, str], FittedSd], videos: int) -> str:
    """The graph's text with fitted standard deviations, each agent's with a comment that says from what."""
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    for agent in dict.fromkeys(agent for agent, _ in fitted):
        setting = plate.agent(agent).agent
        of_agent = {key[1]: fitted_sd for key, fitted_sd in fitted.items() if key[0] == agent}
        count = max(fitted_sd.residuals for fitted_sd in of_agent.values())
        comment = f"{', '.join(of_agent)}: residuals at true boxes, {count} in {plural(videos, 'video')}"
        values = {parameter: float(f"{fitted_sd.value:.3g}") for parameter, fitted_sd in of_agent.items()}
        path = ("targets", name, "nodes", agent, "agent")
        if setting.parameters:
            for parameter, value in values.items():
                text = set_value(text, (*path, setting.plugin, parameter), value, comment)
        else:
            text = set_value(text, path, {setting.plugin: values}, comment)
    return text


def fit_policy(
    text: str, graph: CheckedGraph, videos: Sequence[AnnotatedVideo], end: int | None, seeds: int
) -> str:
    """The graph's text with the activation policy that is chosen on `videos`."""
    import numpy as np

    from bayesnet_track.evaluate.calibration_data import calibration_data, with_features
    from bayesnet_track.evaluate.policies import Trial, candidates, policy_of, search
    from bayesnet_track.evaluate.scores import success_auc

    plate = next(iter(graph.targets.values()))
    rules = plate.inference(plate.root).adapt
    with users_mistake():
        current_policy = policy_of(rules)

    def run(policy: Policy, number: int) -> Trial:
        video, trials = videos[number], []
        measuring = with_features(check_text(write_policy(text, graph, policy), "a candidate"))
        for seed in range(seeds):
            with frames_before(video, end) as frames, users_mistake():
                measured = calibration_data(measuring, video.name, frames, video.truth, seed)
            trials.append((success_auc(measured.iou[measured.seen]), measured.cost_ms))
        auc, cost = np.mean(trials, axis=0)
        complain(f"{video.name}, {_describe(policy)}: AUC {auc:.3f}, {cost:.2f} ms")
        return Trial(float(auc), float(cost))

    with users_mistake():
        choice = search(candidates(current_policy), len(videos), run)
    complain(_summary(choice))
    comment = (
        f"AUC {choice.trial.auc:.3f}, before {choice.own.auc:.3f}; declared {choice.trial.cost_ms:.2f} ms, "
        f"before {choice.own.cost_ms:.2f}; {plural(len(videos), 'video')}"
    )
    return write_policy(text, graph, choice.policy, comment)


def write_policy(text: str, graph: CheckedGraph, policy: Policy, comment: str = "") -> str:
    """The graph's text with an activation policy."""
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    adapt = plate.inference(plate.root).adapt
    assert adapt is not None and adapt.activate is not None and adapt.activate.above is not None
    kind, path = adapt.activate.above.kind, ("targets", name, "nodes", plate.root, "adapt")
    text = set_value(text, (*path, "activate", "above"), {kind: policy.activate}, comment)
    text = set_value(text, (*path, "deactivate", "below"), {kind: policy.deactivate}, comment)
    if policy.sample_every is not None:
        text = set_value(text, (*path, "deactivate", "sample_every"), policy.sample_every, comment)
    return text


def _describe(policy: Policy) -> str:
    sample_every = "" if policy.sample_every is None else f", sample_every {policy.sample_every}"
    return f"on above {policy.activate:g}, off below {policy.deactivate:g}{sample_every}"


def _summary(choice: Chosen) -> str:
    return (
        f"policy: {_describe(choice.policy)}; chosen from {choice.candidates} in {choice.runs} trials: AUC "
        f"{choice.trial.auc:.3f} (the graph's own {choice.own.auc:.3f}), declared cost "
        f"{choice.trial.cost_ms:.2f} ms a frame (own {choice.own.cost_ms:.2f})"
    )


def fit_fusion(text: str, graph: CheckedGraph, videos: Sequence[AnnotatedVideo], end: int | None) -> str:
    """The graph's text with the `correlation` of every learned pool."""
    from bayesnet_track.evaluate.cue_parameters import fit_correlation, learned_pools, pool_errors
    from bayesnet_track.graph.settings.net import pool_exponents
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    with users_mistake():
        pools = learned_pools(plate)
    errors = []
    for video in videos:
        with frames_before(video, end) as frames, users_mistake():
            errors.append(pool_errors(graph, frames, video.truth))
    for pool, children in pools.items():
        with users_mistake():
            fitted = fit_correlation([of_video[pool] for of_video in errors])
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


@dataclass(frozen=True, eq=False)
class AnnotatedVideo:
    """A source and its true corner boxes (n, 4)."""

    name: str
    source: str
    truth: NDArray[np.float64]
    value_range: tuple[float, float] | None = None


def find_videos(options: argparse.Namespace) -> Iterator[AnnotatedVideo]:
    """The videos of `--source` with `--truth`, and of `--folder`."""
    from bayesnet_track.evaluate.truth import read_truth

    if len(options.source) != len(options.truth):
        raise UsageError(
            f"{len(options.source)} --source and {len(options.truth)} --truth: every video needs its truth"
        )
    pairs = [(_name(s), s, Path(t)) for s, t in zip(options.source, options.truth, strict=True)]
    if options.folder is not None:
        truth_files = sorted(Path(options.folder).glob("*/groundtruth.txt"))
        pairs += [
            (f.parent.name, str(f.parent / "img"), f) for f in truth_files if (f.parent / "img").is_dir()
        ]
        if not truth_files:
            raise UsageError(f"{options.folder}: no NAME/groundtruth.txt beside NAME/img")
    if not pairs:
        raise UsageError("no video: give --source with --truth, or --folder")
    counts: dict[str, int] = {}
    for name, source, file in pairs:
        counts[name] = counts.get(name, 0) + 1
        unique = name if counts[name] == 1 else f"{name} {counts[name]}"
        with users_file("--truth", TRUTH_LINES):
            yield AnnotatedVideo(unique, source, read_truth(file, options.truth_format), options.value_range)


@contextmanager
def frames_before(video: AnnotatedVideo, end: int | None) -> Iterator[Iterator[Frame]]:
    """The frames of a video before `end`, all that there are when it is None."""
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.sources import open_source

    with open_source(video.source, 0, end, value_range=video.value_range) as source:
        expected = source.expected_frames
        if expected is not None and end is None and expected != len(video.truth):
            raise UsageError(f"{video.name}: {expected} frames, and {len(video.truth)} boxes of ground truth")
        yield (item for item in source if isinstance(item, Frame))


def _name(source: str) -> str:
    """The name of a source: a folder of pictures of a sequence is called as the sequence is."""
    path = Path(source)
    return (path.parent if path.name in ("img", "img1") else path).name or source
