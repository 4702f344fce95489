"""The command `fit`: calibrate a graph on videos with ground truth, and promises for new videos."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    OK,
    UsageError,
    add_plugins,
    add_truth_format,
    complain,
    say,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.commands.fit_text import (
    calibration_table,
    further_features,
    has_score,
    used_features,
    write_fitted,
)
from bayesnet_track.cli.fitting import (
    AnnotatedVideo,
    add_motion,
    check_text,
    find_videos,
    fit_cue_sds,
    fit_fusion,
    fit_motion_text,
    fit_policy,
    frames_before,
)
from bayesnet_track.cli.options import add_range_option
from bayesnet_track.journal.disk import is_there
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.sources.entrances.notices import notice

if TYPE_CHECKING:
    from bayesnet_track.evaluate.calibration_data import CalibrationData
    from bayesnet_track.graph.checked import CheckedGraph


def check_promises(options: argparse.Namespace, graph: CheckedGraph) -> None:
    """Refuse what would make the promise void, before hours of runs.

    Raises:
        UsageError: the score would be fitted to the same videos, or is none.
    """
    if options.what is not None or options.leave_one_out:
        raise UsageError(
            "--guarantee and --alarm calibrate a graph as it is; fit its score to other videos first, in a "
            "call of its own, with --what"
        )
    plate = next(iter(graph.targets.values()))
    if plate.inference(plate.root).score is None:
        raise UsageError(
            f"{plate.root} has no `score`, which --guarantee and --alarm need; fit one to other videos "
            "first, with --what score"
        )


def check_count(options: argparse.Namespace, videos: int) -> None:
    """Refuse too few videos before they are run."""
    from bayesnet_track.evaluate.guarantees import fewest_videos

    for name in ("guarantee", "alarm"):
        share = getattr(options, name)
        if share is not None and videos < (needed := fewest_videos(share, alarm=name == "alarm")):
            count_text = "there is 1" if videos == 1 else f"there are {videos}"
            raise UsageError(
                f"--{name} {share:g} needs {needed} videos or more, and {count_text}: a new video counts as "
                "one more in which everything is wrong"
            )


def write_promises(
    text: str, graph: CheckedGraph, data: Sequence[CalibrationData], options: argparse.Namespace
) -> str:
    """The graph's text with `guarantee` and `alarm`, as they were asked for; says what is promised."""
    if options.guarantee is not None:
        text = _write_guarantee(text, graph, data, options.guarantee, options.off_target or 0.5)
    if options.alarm is not None:
        text = _write_alarm(text, graph, data, options.alarm)
    complain(
        "This holds for new videos that are exchangeable with these, and is void if one of these was used to "
        "choose or fit anything of the graph."
    )
    return text


def _write_guarantee(
    text: str, graph: CheckedGraph, data: Sequence[CalibrationData], share: float, overlap: float
) -> str:
    from bayesnet_track.evaluate.guarantees import (
        control_afterwards,
        control_risk,
        runs_of,
        share_called_afterwards,
    )
    from bayesnet_track.graph.settings.scores import Guarantee
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    previous = plate.inference(plate.root).guarantee
    frames = (Guarantee(above=0.0) if previous is None else previous).frames
    videos = list(runs_of(data, frames).values())
    with users_mistake():
        control = control_risk(videos, share, overlap)
        afterwards = control_afterwards(videos, share, overlap)
    promised = f"{100 * share:g} %"
    complain(
        f"guarantee: tracking only while the mean score of {plural(frames, 'frame')} is above "
        f"{control.above:g}. Averaged over new videos, the expected share of frames called tracking with "
        f"IoU ≤ {overlap:g} is at most {promised}: a statement about the mean, not about each video. With "
        f"{plural(control.videos, 'video')} the calibrated share may be at most {100 * control.allowed:.2g} "
        f"%; it is {100 * control.risk:.2g} %."
    )
    if not control.called > 0.0:
        complain("guarantee: no frame of these videos would be called tracking; the score does not separate")
    elif math.isfinite(control.called):
        later = share_called_afterwards(videos, afterwards)
        complain(
            f"guarantee: {100 * control.called:.0f} % of the frames with IoU > 0.5 are called tracking, "
            f"{100 * later:.0f} % where a run is judged when it is over."
        )
    value = {"above": control.above, "frames": frames, "share": share, "afterwards": list(afterwards)}
    comment = (
        f"expected share called tracking with IoU <= {overlap:g} at most {promised}; "
        f"{100 * control.risk:.2g} % in {plural(control.videos, 'video')}"
    )
    return set_value(text, ("targets", name, "nodes", plate.root, "guarantee"), value, comment)


def _write_alarm(text: str, graph: CheckedGraph, data: Sequence[CalibrationData], share: float) -> str:
    from bayesnet_track.evaluate.calibration_data import by_video
    from bayesnet_track.evaluate.guarantees import total_evidence
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    videos = list(by_video(data).values())
    with users_mistake():
        total = total_evidence(videos, share)
    total = math.ceil(total * 1e3) / 1e3  # rounded up, to the safe side
    odds = (len(videos) + 1) * share - 1.0
    needs = f"{math.log(total / odds):.3g}" if odds > 1e-9 else "more than any"
    complain(
        f"alarm: false in a whole video with a probability of at most {100 * share:g} %, if the video is "
        f"exchangeable with these {len(videos)} up to where its target is lost. It takes {needs} nats of "
        "evidence, of which a frame gives at most one."
    )
    value = {"total": total, "videos": len(videos), "share": share}
    comment = f"false in at most {100 * share:g} % of videos; {plural(len(videos), 'video')}"
    return set_value(text, ("targets", name, "nodes", plate.root, "alarm"), value, comment)


WHAT = ("score", "localization_error", "lost", "ud", "temperature", "sds", "policy", "fusion")
USUAL_WHAT = "score,localization_error,lost"
BEFORE = ("sds", "policy", "fusion")
"""What changes the tracking, and is fitted before the rest."""


def _fit(options: argparse.Namespace) -> int:
    """Estimate, print or write."""
    from bayesnet_track.evaluate.calibration import SIGNS, leave_one_out
    from bayesnet_track.evaluate.calibration import fit_calibration as estimate
    from bayesnet_track.graph.text.load import load_graph

    promises = options.guarantee is not None or options.alarm is not None
    if options.off_target is not None and options.guarantee is None:
        raise UsageError("--off-target says which frames are wrong for --guarantee; give that, too")
    quantities = () if promises else _choose("--what", options.what or USUAL_WHAT, WHAT)
    graph, text = load_graph(options.graph), graph_text(options.graph)
    if len(graph.targets) > 1:
        first, *omitted = graph.targets
        notice(
            f"{options.graph} has the classes {', '.join(graph.targets)}: {first}, the first one, is fitted, "
            f"and {', '.join(omitted)} not; to fit another class, put it first in `targets`"
        )
    features = used_features(graph)
    if options.features is not None:
        features = _choose("--features", options.features, (*SIGNS, *further_features(graph)))
    path = None if options.out is None else Path(options.out)
    if path is not None:
        with users_output(path):
            if is_there(path) and not options.overwrite:
                raise UsageError(f"{path} exists; --overwrite replaces it")
    _check_what(quantities, graph, options.leave_one_out)
    if promises:
        check_promises(options, graph)
    if options.motion:
        text, from_what = fit_motion_text(text, graph, options)
        check_text(text, str(path or options.graph))
        return _put(path, text, f"fitted to {from_what}")
    videos = list(find_videos(options))
    if promises:
        check_count(options, len(videos))
        data = _calibration_data(graph, videos, options, temperatures=False)
        written = write_promises(text, graph, data, options)
        check_text(written, str(path or options.graph))
        return _put(path, written, f"calibrated on {plural(len(videos), 'video')}")
    if "sds" in quantities:
        text = fit_cue_sds(text, graph, videos, options.end)
        graph = check_text(text, str(path or options.graph))
    if "fusion" in quantities:
        text = fit_fusion(text, graph, videos, options.end)
        graph = check_text(text, str(path or options.graph))
    if "policy" in quantities:
        text = fit_policy(text, graph, videos, options.end, options.seeds)
        graph = check_text(text, str(path or options.graph))
    if set(quantities) <= set(BEFORE):
        return _put(path, text, f"fitted to {plural(len(videos), 'video')}")
    data = _calibration_data(graph, videos, options, "temperature" in quantities)
    with users_mistake():
        if options.leave_one_out:
            rows, everyone = leave_one_out(data, features)
            say(calibration_table(rows, everyone))
            return OK
        fitted = estimate(data, features, keep_score="score" not in quantities)
    written = write_fitted(text, graph, fitted, quantities)
    check_text(written, str(path or options.graph))
    return _put(path, written, f"fitted to {fitted.frames} frames of {plural(fitted.videos, 'video')}")


def _check_what(quantities: Sequence[str], graph: CheckedGraph, leave_one_out: bool) -> None:
    """Refuse what cannot be estimated together, or of this graph; raises UsageError."""
    if leave_one_out and not set(quantities).isdisjoint(BEFORE):
        raise UsageError(
            "--leave-one-out judges score and regions; fit sds, fusion and policy to other videos first"
        )
    by_score = [quantity for quantity in ("localization_error", "lost") if quantity in quantities]
    if by_score and "score" not in quantities and not has_score(graph):
        raise UsageError(
            f"--what: {' and '.join(by_score)} {'go' if len(by_score) > 1 else 'goes'} by the score, and the "
            "graph has none; add score to --what"
        )
    if "ud" in quantities and "policy" in quantities:
        raise UsageError(
            "--what: ud and policy both set the levels of `activate` and `deactivate`; choose one"
        )


def _put(path: Path | None, text: str, origin: str) -> int:
    if path is None:
        say(text.removesuffix("\n"))
    else:
        _write(path, text)
        say(f"{path}: {origin}")
    return OK


def graph_text(graph: str) -> str:
    """The text of a graph file, or of an installed graph."""
    from bayesnet_track.graphs import find_graph, graph_names

    return (find_graph(graph) if graph in graph_names() else Path(graph)).read_text(encoding="utf-8")


def _choose(option: str, text: str, available: Sequence[str]) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in available:
            raise UsageError(f"{option}: no {name!r}; there are {', '.join(available)}")
    if not names:
        raise UsageError(f"{option} names nothing; there are {', '.join(available)}")
    return names


def _calibration_data(
    graph: CheckedGraph, videos: Sequence[AnnotatedVideo], options: argparse.Namespace, temperatures: bool
) -> list[CalibrationData]:
    from bayesnet_track.evaluate.calibration_data import calibration_data, with_features

    measuring, data = with_features(graph), []
    for video in videos:
        for seed in range(options.seeds):
            with frames_before(video, options.end) as frames, users_mistake():
                video_data = calibration_data(measuring, video.name, frames, video.truth, seed, temperatures)
            complain(
                f"{video.name}, seed {seed}: {video_data.frames} frames, mean IoU "
                f"{video_data.iou[video_data.seen].mean():.3f}"
            )
            data.append(video_data)
    return data


def _write(path: Path, text: str) -> None:
    """The whole file or none of it."""
    from bayesnet_track.journal.writer import write_atomically

    write_atomically(path, text.encode("utf-8"))


def _share(text: str) -> float:
    """A share above 0 and below 1."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share above 0 and below 1, such as 0.05")
    return value


def _add_fit(commands: argparse._SubParsersAction[Any]) -> None:
    fit = commands.add_parser("fit", help="fit a graph's score and regions to videos with ground truth")
    fit.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    fit.add_argument(
        "--source", action="append", default=[], help="video, folder of images, or glob; may be repeated"
    )
    fit.add_argument(
        "--truth", action="append", default=[], metavar="FILE", help="ground-truth file of each --source"
    )
    add_truth_format(fit)
    fit.add_argument(
        "--folder", metavar="DATA", help="use every NAME/img in this folder that has NAME/groundtruth.txt"
    )
    add_range_option(fit)
    fit.add_argument("--end", type=whole_number(2), metavar="N", help="frame of each video to stop before")
    fit.add_argument(
        "--seeds", type=whole_number(1), default=2, metavar="N", help="runs over each video (default 2)"
    )
    fit.add_argument(
        "--what",
        metavar="LIST",
        help="of score, localization_error, lost, ud, temperature, sds, policy, fusion (default "
        "score,localization_error,lost)",
    )
    fit.add_argument(
        "--fusion",
        action="store_const",
        const="fusion",
        dest="what",
        help="the same as --what fusion: the correlation of every learned pool",
    )
    fit.add_argument(
        "--features",
        metavar="LIST",
        help="features of the score, verifiers by name, the confidence of an agent as confidence.AGENT "
        "(default: those of the graph's score with a coefficient, else log_ud_box,evidence)",
    )
    fit.add_argument(
        "--guarantee",
        type=_share,
        metavar="SHARE",
        help="instead of --what: calibrate the score from which on a frame counts as tracking, so that over "
        "new videos on average at most this share of frames counts so while off target",
    )
    fit.add_argument(
        "--off-target",
        type=_share,
        metavar="IOU",
        help="for --guarantee: an IoU up to which a frame is off target (default 0.5); 0.1 is on something "
        "else",
    )
    fit.add_argument(
        "--alarm",
        type=_share,
        metavar="SHARE",
        help="calibrate, instead of --what, an alarm that is false in at most this share of whole videos",
    )
    add_motion(fit)
    fit.add_argument("-o", "--out", metavar="FILE", help="graph file to write (default: print it)")
    fit.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
    fit.add_argument(
        "--leave-one-out",
        action="store_true",
        help="print how well a fit to the other videos calibrates each video, and write nothing",
    )
    add_plugins(fit)


COMMANDS = {"fit": (_add_fit, _fit)}
