"""Commands that review a run: `log`, `score`, and `verify`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    BAD_SOURCE,
    INCOMPLETE,
    OK,
    UsageError,
    add_truth_format,
    by_status,
    complain,
    pixels,
    say,
    users_mistake,
    whole_number,
)
from bayesnet_track.sources.entrances.notices import notice

if TYPE_CHECKING:
    from bayesnet_track.evaluate.mot import MotScore
    from bayesnet_track.evaluate.truth import Tracks
    from bayesnet_track.graph.spec import Target
    from bayesnet_track.journal.events.event import Event
    from bayesnet_track.journal.metrics import FrameMetrics
    from bayesnet_track.runtime.checkpoints.standing import Verified
    from bayesnet_track.runtime.recording.rundir import RunDirectory


def _log(options: argparse.Namespace) -> int:
    """Tell a run's reconfigurations."""
    from bayesnet_track.journal.codec import to_json
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.journal.text.sentences import (
        has_several_targets,
        kinds_of,
        name_targets,
        narrate,
        why,
    )
    from bayesnet_track.journal.text.story import check_target, describe_life, narrate_all
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    directory = RunDirectory.open(options.run)
    events = list(read_events(directory.journal, complain))
    filters = ("node", "kind", "frames", "json", "short")
    filtered_by = [name for name in filters if getattr(options, name) not in (None, False)]
    if options.short and options.json:
        raise UsageError("--short is of sentences; leave out --json")
    if options.why is not None and filtered_by:
        raise UsageError(f"--why explains one frame; leave out --{' and --'.join(filtered_by)}")
    if options.target is not None:
        with users_mistake():
            check_target(events, options.target)
    if options.why is not None or (options.target is not None and not filtered_by):
        metrics = _lines(directory, options.why, options.target)
        with users_mistake():
            if options.why is None:
                account = describe_life(events, metrics, options.target)
            else:
                account = why(events, metrics, options.why, options.target, _coefficients(directory))
        say(name_targets(account, kinds_of(events)))
        return OK
    selected = chosen_events(events, options)
    if not selected:
        _check_node(directory, options.node)
        complain("no events match")
    name_target, kinds = has_several_targets(events), kinds_of(events)
    lines: Iterable[str]
    if options.json:
        lines = map(to_json, selected)
    elif options.kind is not None:
        lines = (narrate(event, kinds, name_target) for event in selected)
    else:
        lines = narrate_all(selected, kinds, name_target)
    for line in lines:
        say(by_status(_shorten(line) if options.short else line, sys.stdout))
    if not filtered_by and (fixed := _fixed_targets(directory)):
        complain(
            f"the graph has no rule that switches agents of {', '.join(fixed)}: all of them look in every "
            "frame; `bayesnet-track init` writes a graph that switches its agents"
        )
    return OK


def _shorten(sentence: str) -> str:
    """The sentence without its reasons: the frame, and what changed.

    >>> _shorten("frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at 213")
    'frame 29: motion on'
    >>> _shorten("frame 0: ball 1 starts, centre 3, 4, 10 x 8 px → color on")
    'frame 0: ball 1 starts → color on'
    """
    from bayesnet_track.journal.text.sentences import split_sentence

    frame, why, change, _ = split_sentence(sentence)
    start, starts, _ = why.partition(" starts, ")
    return f"{frame}{start} starts → {change}" if starts else frame + change


def _lines(directory: RunDirectory, frame: int | None, target: str | None) -> Iterator[FrameMetrics]:
    """Measurements of one frame, or of the first and the last if the run lacks it; else of the target."""
    from bayesnet_track.journal.frame_file import FrameFile
    from bayesnet_track.journal.reader import read_metrics

    if frame is None:
        yield from read_metrics(directory.frames, complain, target)
        return
    file = FrameFile(directory.frames, complain)
    places = [place for place in file.places if place.frame == frame]
    yield from file.lines(places or [*file.places[:1], *file.places[-1:]])


def chosen_events(events: Sequence[Event], options: argparse.Namespace) -> list[Event]:
    """The events that --target, --node, --kind and --frames leave."""
    from bayesnet_track.journal.text.sentences import Filter

    frames = None
    if options.frames is not None:
        first, separator, end = options.frames.partition(":")
        try:
            frames = (int(first or 0), int(end) if end else 2**62)
        except ValueError:
            frames = (0, 0)
        if not separator and first and frames[1] > 0:
            frames = (frames[0], frames[0] + 1)
        if frames[0] >= frames[1]:
            raise UsageError(
                f"--frames {options.frames!r}: A:B with A < B is needed (or :B, or A:, or one A)"
            )
    with users_mistake():
        keep = Filter(options.node, options.kind, frames, options.target)
    return [event for event in events if keep.keeps(event)]


def _targets(directory: RunDirectory) -> Mapping[str, Target]:
    """Types of targets of the run's graph; none where it cannot be read: a run is explained without, too."""
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graph.text.messages import GraphError

    try:
        return read_graph(directory.graph)[0].targets
    except GraphError:
        return {}


def _fixed_targets(directory: RunDirectory) -> list[str]:
    """Types of targets with several agents, none of which a rule ever switches."""
    from bayesnet_track.graph.spec import AgentNode, InferenceNode

    fixed = []
    for name, target in _targets(directory).items():
        agents = [node for node in target.nodes.values() if isinstance(node, AgentNode)]
        has_rules = any(isinstance(node, InferenceNode) and node.adapt for node in target.nodes.values())
        if len(agents) > 1 and not has_rules and not any(agent.adapts for agent in agents):
            fixed.append(name)
    return fixed


def _coefficients(directory: RunDirectory) -> dict[str, Mapping[str, float]]:
    """Type of target -> feature of its score -> coefficient, and `bias`."""
    from bayesnet_track.graph.spec import InferenceNode

    return {
        name: {"bias": node.score.settings.bias, **node.score.settings.coefficients}
        for name, target in _targets(directory).items()
        for node in target.nodes.values()
        if isinstance(node, InferenceNode) and node.score is not None
    }


def _check_node(directory: RunDirectory, node: str | None) -> None:
    """Refuse a node that the run's graph does not have."""
    from bayesnet_track.graph.checks.several_cameras import per_camera
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graph.text.messages import nearest

    if node is None or not directory.graph.is_file():
        return
    spec, _ = read_graph(directory.graph)
    names = [
        name for target in spec.targets.values() for name in per_camera(target, tuple(spec.cameras)).nodes
    ]
    if node not in names:
        suggestion = nearest(node, names)
        hint = f"; nearest: {suggestion}" if suggestion else ""
        raise UsageError(f"no node {node!r} in the run's graph; there are {', '.join(names)}{hint}")


def _score(options: argparse.Namespace) -> int:
    """Score a run, or a file of tracks, against ground truth."""
    from bayesnet_track.evaluate.runs import score_run, tracks_of_run
    from bayesnet_track.evaluate.truth import is_mot
    from bayesnet_track.evaluate.world import is_world_truth
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    path = _written(Path(options.run))
    if os.path.isfile(path):  # noqa: PTH113 (a name that is too long is no file, and raises nothing)
        if not options.truth:
            raise UsageError(f"{path}: a file of tracks brings no ground truth; name one with --truth FILE")
        if is_world_truth(Path(options.truth)):
            return _score_world(path, Path(options.truth), options)
        return _score_several(path, Path(options.truth), options)
    directory = RunDirectory.open(path)
    truth = Path(options.truth) if options.truth else directory.truth
    if not os.path.isfile(truth):  # noqa: PTH113
        raise UsageError(f"no ground truth at {truth}; name one with --truth FILE")
    if is_world_truth(truth):
        return _score_world(directory.csv, truth, options, directory)
    with users_mistake():
        if is_mot(truth, options.truth_format):
            return _score_several(tracks_of_run(directory.path), truth, options, directory)
        for option in ("--cutoff", "--trajectories", "--class"):
            if getattr(options, option[2:].replace("class", "classes")):
                raise UsageError(
                    f"{option}: {truth} is the ground truth of one target, not MOT; leave it out"
                )
        result = score_run(directory.path, truth, options.target, options.truth_format)
    say(result.json() if options.json else result.text(explained=True))
    return OK


def _written(path: Path) -> Path:
    """The file that has the boxes of a file of a run that was not written, or the run."""
    from bayesnet_track.runtime.recording.rundir import FILES

    run, boxes = path.parent, path.with_name(FILES["mot"])
    if path.name not in (FILES["csv"], FILES["mot"]) or path.exists():
        return path
    if not (run / FILES["journal"]).is_file():
        return path
    if not boxes.exists():
        notice(f"{path}: not written; read {run / FILES['frames']}, which has the same boxes")
        return run
    notice(
        f"{path}: not written (`run --tracks-csv`, or `export {run} --format csv`); "
        f"read {boxes}, which has the same boxes"
    )
    return boxes


def _score_several(
    tracks: Path | Tracks, truth: Path, options: argparse.Namespace, run: RunDirectory | None = None
) -> int:
    from bayesnet_track.evaluate.gospa import CUTOFF_PX
    from bayesnet_track.evaluate.mot import score_classes, score_mot
    from bayesnet_track.evaluate.runs import frames_of_run, say_misplaced
    from bayesnet_track.evaluate.truth import class_names, of_classes, read_pair

    if options.target is not None:
        raise UsageError(f"--target: all targets in {truth} are scored at once; leave it out")
    cutoff = CUTOFF_PX if options.cutoff is None else options.cutoff
    with users_mistake():
        strided, ran = (None, None) if run is None else frames_of_run(run.path)
        true, tracked = read_pair(tracks, truth, strided, ran, options.truth_format)
        if run is not None:
            say_misplaced(run.path, truth, true.boxes)
        selected = options.classes or class_names(true)
        pair = of_classes(true, tracked, selected) if options.classes else (true, tracked)
        result = score_mot(*pair, cutoff, options.trajectories)
        by_class = score_classes(true, tracked, selected, cutoff) if len(selected) > 1 else {}
    if options.json:
        classes = (
            {"classes": {name: asdict(class_score) for name, class_score in by_class.items()}}
            if by_class
            else {}
        )
        say(json.dumps(asdict(result) | classes))
        return OK
    say(result.text(explained=True))
    if by_class:
        say("\n" + _class_table(by_class))
        if not class_names(tracked):
            say("the tracks have no classes: for each class, boxes on targets of another one are left out")
    return OK


_COLUMNS = ("true_ids", "true_boxes", "mota", "idf1", "hota", "fp", "fn", "idsw")


def _class_table(scores: Mapping[str, MotScore]) -> str:
    """A line for each class, under a line of names."""
    width = max(len(name) for name in (*scores, "class"))
    lines = [f"{'class':<{width}} " + " ".join(f"{name:>10}" for name in _COLUMNS)]
    for name, class_score in scores.items():
        values = [getattr(class_score, column) for column in _COLUMNS]
        cells = [f"{value:>10}" if isinstance(value, int) else f"{value:>10.4f}" for value in values]
        lines.append(f"{name:<{width}} " + " ".join(cells))
    return "\n".join(lines)


def _score_world(
    tracks: Path, truth: Path, options: argparse.Namespace, run: RunDirectory | None = None
) -> int:
    """Score places on the ground, in metres."""
    import math

    from bayesnet_track.evaluate.world import (
        MATCH_M,
        end_of_run,
        read_world_tracks,
        read_world_truth,
        score_world,
    )

    for option, value in (
        ("--target", options.target),
        ("--class", options.classes),
        ("--trajectories", options.trajectories),
        ("--truth-format", options.truth_format),
    ):
        if value:
            raise UsageError(f"{option}: {truth} is a ground truth in metres (t,id,x,y); leave it out")
    with users_mistake():
        tracked = read_world_tracks(tracks)
        end_s = math.inf if run is None else end_of_run(run.path, tracks)
        cutoff = MATCH_M if options.cutoff is None else options.cutoff
        result = score_world(read_world_truth(truth), tracked, until=end_s, cutoff_m=cutoff)
    say(result.json() if options.json else result.text())
    return OK


def _add_log(commands: argparse._SubParsersAction[Any]) -> None:
    log = commands.add_parser(
        "log", help="print every reconfiguration of a run as a sentence, with its reason"
    )
    log.add_argument("run", metavar="RUN", help="run directory")
    log.add_argument(
        "--target",
        metavar="ID",
        help="the history of one target; with --node, --kind, --frames, --short or --json: its events",
    )
    log.add_argument("--node", help="only this node")
    log.add_argument("--kind", help="only this kind of event: activated, deactivated, self_stopped, ...")
    log.add_argument("--frames", metavar="A:B", help="only frames A to B, B excluded")
    log.add_argument(
        "--why",
        type=whole_number(0),
        metavar="N",
        help="what was active in frame N, and why; alone, or with --target",
    )
    log.add_argument("--short", action="store_true", help="only what changed, without the reasons")
    log.add_argument("--json", action="store_true", help="print the events as they are in the journal")


def _add_score(commands: argparse._SubParsersAction[Any]) -> None:
    score = commands.add_parser("score", help="score a run against ground truth")
    score.add_argument("run", metavar="RUN", help="run directory, or a file of tracks (MOT)")
    score.add_argument(
        "--truth",
        help="ground-truth file: one box per line, or MOT to score all targets together (default: the "
        "run's own truth.txt), or places in metres, with a header line t,id,x,y",
    )
    score.add_argument(
        "--target", metavar="ID", help="which target, if the run has several and the ground truth one"
    )
    score.add_argument(
        "--cutoff",
        type=pixels,
        metavar="PX",
        help="several targets: the cut-off c of GOSPA and OSPA(2) (default: 50); in metres (default: 1) for "
        "places",
    )
    score.add_argument(
        "--trajectories",
        action="store_true",
        help="several targets: also trajectory GOSPA; slow if many cross",
    )
    score.add_argument(
        "--class",
        dest="classes",
        action="append",
        metavar="CLASS",
        help="several targets: only those of this class of the ground truth, a name or number; repeat it for "
        "more, which are also scored one by one (default: all)",
    )
    add_truth_format(score)
    score.add_argument("--json", action="store_true", help="print the scores as JSON")


SAID = {
    "missing": "missing",
    "truncated": "truncated since it was written",
    "changed": "changed since it was written",
    "extra": "not of this run",
}
WITHOUT = {
    "unfinished": "unfinished: it has no manifest to compare with; `bayesnet-track resume {run}` finishes it",
    "running": "a process is writing it now; verify it when it has ended",
}


def _verify(options: argparse.Namespace) -> int:
    """Compare a run with its manifest."""
    from bayesnet_track.runtime.checkpoints.standing import verify

    verified = verify(options.run)
    if options.json:
        report = {
            "run": options.run,
            "status": verified.status,
            "result": verified.result,
            "outputs": verified.outputs,
        }
        say(json.dumps(report, indent=1))
    else:
        _report(options.run, verified)
    return {"verified": OK, "changed": BAD_SOURCE}.get(verified.status, INCOMPLETE)


def _report(run: str, verified: Verified) -> None:
    if verified.status in WITHOUT:
        say(f"{run}: {WITHOUT[verified.status].format(run=run)}")
        return
    wrong = {name: finding for name, finding in verified.outputs.items() if finding != "ok"}
    for name, finding in wrong.items():
        say(f"{run}/{name}: {SAID[finding]}")
    if wrong:
        say(f"{run}: changed: {len(wrong)} of {len(verified.outputs)} files are not as the run left them")
    else:
        say(f"{run}: verified: {len(verified.outputs)} files, result {verified.result}")


def _add_verify(commands: argparse._SubParsersAction[Any]) -> None:
    verify = commands.add_parser(
        "verify",
        help="check that the files of a finished run are unchanged",
        description="Compare every file of a run with the size and SHA-256 in its manifest.json. Exit code 0:"
        " all are unchanged; 4: a file was changed, truncated, removed or added, or this is no "
        "run; 5: the run is unfinished (`resume` finishes it) or still being written.",
    )
    verify.add_argument("run", metavar="RUN", help="run directory")
    verify.add_argument("--json", action="store_true", help="print what was found as JSON")


COMMANDS = {"log": (_add_log, _log), "score": (_add_score, _score), "verify": (_add_verify, _verify)}
