"""`fit --guarantee` and `fit --alarm`: what may be promised of new videos, calibrated on whole videos."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError, complain, users_mistake
from bayesnet_track.journal.text.wording import plural

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
        if share is not None and videos < (least := fewest_videos(share, alarm=name == "alarm")):
            there = "there is 1" if videos == 1 else f"there are {videos}"
            raise UsageError(
                f"--{name} {share:g} needs {least} videos or more, and {there}: a new video counts as one "
                "more in which everything is wrong"
            )


def write_promises(
    text: str, graph: CheckedGraph, data: Sequence[CalibrationData], options: argparse.Namespace
) -> str:
    """The graph's text with `guarantee` and `alarm`, as they were asked for; says what is promised."""
    if options.guarantee is not None:
        text = _write_guarantee(text, graph, data, options.guarantee)
    if options.alarm is not None:
        text = _write_alarm(text, graph, data, options.alarm)
    complain(
        "This holds for new videos that are exchangeable with these, and is void if one of these was used to "
        "choose or fit anything of the graph."
    )
    return text


def _write_guarantee(text: str, graph: CheckedGraph, data: Sequence[CalibrationData], share: float) -> str:
    from bayesnet_track.evaluate.guarantees import (
        control_afterwards,
        control_risk,
        runs_of,
        share_called_afterwards,
    )
    from bayesnet_track.graph.settings.scores import Guarantee
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    before = plate.inference(plate.root).guarantee
    frames = (Guarantee(above=0.0) if before is None else before).frames
    videos = list(runs_of(data, frames).values())
    with users_mistake():
        found, afterwards = control_risk(videos, share), control_afterwards(videos, share)
    promised = f"{100 * share:g} %"
    complain(
        f"guarantee: tracking only while the mean score of {plural(frames, 'frame')} is above "
        f"{found.above:g}. Averaged over new videos, the expected share of frames called tracking with "
        f"IoU ≤ 0.5 is at most {promised}: a statement about the mean, not about each video. With "
        f"{plural(found.videos, 'video')} the calibrated share may be at most {100 * found.allowed:.2g} %; "
        f"it is {100 * found.risk:.2g} %."
    )
    if not found.called > 0.0:
        complain("guarantee: no frame of these videos would be called tracking; the score does not separate")
    elif math.isfinite(found.called):
        later = share_called_afterwards(videos, afterwards)
        complain(
            f"guarantee: {100 * found.called:.0f} % of the frames with IoU > 0.5 are called tracking, "
            f"{100 * later:.0f} % where a run is judged when it is over."
        )
    value = {"above": found.above, "frames": frames, "share": share, "afterwards": list(afterwards)}
    comment = (
        f"expected share called tracking with IoU <= 0.5 at most {promised}; {100 * found.risk:.2g} % in "
        f"{plural(found.videos, 'video')}"
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
