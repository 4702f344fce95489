"""Further commands that write runs: `demo`, `resume`, `smooth`, and `simulate`."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    BAD_SOURCE,
    OK,
    UsageError,
    add_plugins,
    add_set_option,
    add_truth_format,
    add_view_options,
    by_status,
    check_free,
    complain,
    parse_start,
    read_start,
    run_folder,
    say,
    set_values,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.commands.graphs import SCENE_GRAPHS
from bayesnet_track.cli.commands.tracking import executor_of, track_source
from bayesnet_track.cli.following import Narrator, begin_again, follow_run, open_view
from bayesnet_track.cli.options import (
    add_checkpoints,
    add_executor_options,
    add_output_options,
    add_range_option,
    add_run_options,
)

if TYPE_CHECKING:
    from bayesnet_track.engine.simulating import Simulated
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.sources.scenes.library import SceneSource


def _demo(options: argparse.Namespace) -> int:
    """Track in a built-in scene, then tell what happened and how well it went."""
    from bayesnet_track.sources.scenes.people import ROOMS

    if options.scene in ROOMS:
        return _demo_room(options, ROOMS[options.scene])
    with open_view(options) as view:
        return _demo_scene(options, view)


def _demo_scene(options: argparse.Namespace, view: LiveView | None) -> int:
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.journal.text.sentences import has_several_targets, kinds_of
    from bayesnet_track.journal.text.story import narrate_all
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.sources.scenes.library import SceneSource

    with users_mistake():
        source = SceneSource.named(options.scene, options.seed, options.end)
    scene = source.scene
    graph = load_graph(options.graph or SCENE_GRAPHS.get(options.scene, "two_squares"))
    if options.set:
        graph = set_values(graph.text, options.set, True, graph.masks, graph.calibrations)
    # Only what an earlier demo wrote there is replaced without being asked to.
    folder = run_folder(options.out or f"runs/{options.scene}")
    options.overwrite = options.overwrite or options.out is None
    starts = [
        Start(box, plate) for plate, box in (*scene.starts, *scene.part_starts) if plate in graph.targets
    ]
    starts = [] if has_births(graph) else starts or [Start(scene.start_box)]
    has_truth = bool(starts) and starts[0].box == scene.start_box
    world = None if scene.ground is None else _write_inputs(options, source, folder)
    code = track_source(options, graph, source, starts, folder, video=True, view=view)
    directory = RunDirectory.open(folder) if code == OK else None
    if options.json and directory is not None:
        scores = asdict(score_run(folder, directory.truth, target="1")) if has_truth else {}
        say(json.dumps({"run": str(folder), "scene": options.scene, "scores": scores}))
    if directory is None or options.quiet or options.json:
        return code
    events = list(read_events(directory.journal))
    name_target, kinds = has_several_targets(events), kinds_of(events)
    if not options.verbose:
        say("\nwhat was decided, and why:")
        for line in narrate_all(events, kinds, name_target):
            say(by_status(line, sys.stdout))
    if has_truth:
        whose = f" of {kinds['1']} 1" if name_target else ""
        say(f"\nagainst the ground truth{whose}:")
        say(score_run(folder, directory.truth, target="1").text(explained=True))
    if world is not None:
        _say_world(directory, world)
    explained_frame = min(29, source.expected_frames - 1)
    say(
        f"\nopen {directory.video} to watch it; `bayesnet-track report {folder}` writes a page about it; "
        f"`bayesnet-track log {folder} --why {explained_frame}` explains a frame"
    )
    return code


def _demo_room(options: argparse.Namespace, fault: str) -> int:
    """Track by the detections of several cameras in a room, of which the last one has the fault."""
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.journal.text.sentences import kinds_of
    from bayesnet_track.journal.text.story import narrate_all
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.several_cameras import open_cameras
    from bayesnet_track.sources.scenes.people import write_room

    if options.view is not None:
        raise UsageError(f"--view is of one image, and {options.scene} has several cameras")
    run_path = run_folder(options.out or f"runs/{options.scene}")
    options.overwrite = options.overwrite or options.out is None
    folder = run_path.with_name(f"{run_path.name}_inputs")
    with users_output(folder):
        path, options.detections, truth = write_room(folder, fault, options.seed)
    graph = load_graph(options.graph or path)
    if options.set:
        graph = set_values(graph.text, options.set, True, graph.masks, graph.calibrations)
    with users_mistake(), open_cameras(graph, None, options.detections, end=options.end) as source:
        code = track_source(options, graph, source, [], run_path, video=False)
    if code != OK:
        return code
    directory = RunDirectory.open(run_path)
    if options.json:
        say(json.dumps({"run": str(run_path), "scene": options.scene}))
    elif not options.quiet:
        events = list(read_events(directory.journal))
        say("\nwhat was decided, and why:")
        for line in narrate_all(events, kinds_of(events), True):
            say(by_status(line, sys.stdout))
        _say_world(directory, truth)
    return code


def _write_inputs(options: argparse.Namespace, source: SceneSource, run_path: Path) -> Path:
    """Write the scene's detections, calibration and places in metres beside the run; the last one's path."""
    from bayesnet_track.vision.camera_calibration import write_camera

    ground = source.scene.ground
    assert ground is not None
    folder = run_path.with_name(f"{run_path.name}_inputs")
    truth = folder / "truth.csv"
    with users_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "detections.txt").write_text(ground.detections_mot(), encoding="utf-8")
        truth.write_text(ground.truth_csv(source.expected_frames), encoding="utf-8")
        write_camera(folder / "camera.yaml", ground.camera, {})
    options.detections = str(folder / "detections.txt")
    return truth


def _say_world(directory: RunDirectory, truth: Path) -> None:
    """Print the scores in metres, and what to look at."""
    from bayesnet_track.evaluate.world import read_world_tracks, read_world_truth, score_world

    say("\nagainst the ground truth in metres:")
    say(score_world(read_world_truth(truth), read_world_tracks(directory.csv)).text())
    say(f"\n{directory.csv} has places, speeds and their intervals; {truth.parent} the inputs")


def _add_demo(commands: argparse._SubParsersAction[Any]) -> None:
    demo = commands.add_parser(
        "demo", help="track a target in a built-in synthetic scene; nothing to download"
    )
    demo.add_argument(
        "scene", nargs="?", default="two_squares", metavar="SCENE", help="default two_squares; see `list`"
    )
    demo.add_argument("--graph", help="graph to use instead of the scene's own")
    demo.add_argument(
        "-o", "--out", metavar="RUN", help="run directory (default runs/SCENE, replaced if it exists)"
    )
    demo.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    add_set_option(demo)
    add_run_options(demo)
    add_view_options(demo)
    add_plugins(demo)


def _resume(options: argparse.Namespace) -> int:
    """Go on with a run."""
    from bayesnet_track.runtime.checkpoints.resume import resume
    from bayesnet_track.runtime.checkpoints.standing import standing
    from bayesnet_track.runtime.recording.manifest import settle_broken
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.results import Summary

    directory = RunDirectory(Path(options.run))
    settle_broken(directory)
    if standing(directory.path).is_finished:
        for _ in resume(directory.path):  # removes what a kill in the last moment left
            pass
        if not (options.quiet or options.json):
            say(f"{directory.path}: it is finished; there is nothing to do")
        if options.json:
            say(json.dumps({"run": str(directory.path), "complete": True, "reason": "end_of_source"}))
        return OK
    summary, expected = Summary(), _expected(directory)
    with open_view(options) as view:
        if view is not None:
            begin_again(options, view, directory, expected)
        results = resume(
            directory.path,
            summary=summary,
            checkpoint_every=options.checkpoint_every,
            executor=executor_of(options),
            allow_other_machine=options.allow_other_machine,
            sinks=[*([Narrator()] if options.verbose else []), *([] if view is None else [view])],
            inputs=view if view is not None and view.controls.can_switch else None,
            notice=lambda text: complain(f"{directory.path}: {text}"),
        )
        return follow_run(options, results, summary, expected, directory.path, view)


def _expected(directory: RunDirectory) -> int | None:
    """The number of frames to be tracked by the journal."""
    from bayesnet_track.journal.codec import JournalError
    from bayesnet_track.journal.events.runs import RunStarted
    from bayesnet_track.journal.reader import read_events

    try:
        first = next(read_events(directory.journal), None)
    except (OSError, JournalError):
        return None
    return first.declared_frames if isinstance(first, RunStarted) else None


def _add_resume(commands: argparse._SubParsersAction[Any]) -> None:
    resume = commands.add_parser(
        "resume",
        help="continue a run that was interrupted",
        description="Continue from the last checkpoint of a run that was killed, interrupted or out of disk "
        "space. The run directory ends up as that of an uninterrupted run, byte for byte, except "
        "for the times.",
    )
    resume.add_argument("run", metavar="RUN", help="run directory")
    add_output_options(resume)
    resume.add_argument(
        "--allow-other-machine",
        action="store_true",
        help="continue although the machine, its instruction sets or the libraries differ from those "
        "of the run so far; the result then differs from that of an uninterrupted run",
    )
    add_checkpoints(resume)
    add_plugins(resume)
    add_executor_options(resume)
    add_view_options(resume)


def _smooth(options: argparse.Namespace) -> int:
    """Smooth a run and write the result."""
    from bayesnet_track.runtime.recording.manifest import write_smoothed
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError
    from bayesnet_track.runtime.smoothing import KeptBeliefsError
    from bayesnet_track.runtime.smoothing import smooth as smooth_run

    try:
        run = open_run(options.run, complain)
    except RunDirectoryError as error:
        complain(f"bayesnet-track smooth: {error}")
        return BAD_SOURCE
    try:
        smoothed = smooth_run(run, options.draws, options.seed, options.map)
    except KeptBeliefsError as error:
        raise UsageError(str(error)) from error
    write_smoothed(run, smoothed, Path(options.out), options.overwrite)
    frames = len({line.frame for line in smoothed.metrics})
    say(f"{options.out}: {frames} frames smoothed; `bayesnet-track report {options.out}` makes a page")
    return OK


def _add_smooth(commands: argparse._SubParsersAction[Any]) -> None:
    smooth = commands.add_parser(
        "smooth",
        help="estimate every frame of a finished run from the whole sequence",
        description="Run backward over the beliefs that `run --keep-beliefs` kept, without the video. The "
        "result is another run: boxes, uncertainties and regions are those given all frames; "
        "decisions, status and score are unchanged. Exit code 2: the run kept no beliefs.",
    )
    smooth.add_argument("run", metavar="RUN", help="run directory, written with --keep-beliefs")
    smooth.add_argument("--out", metavar="SMOOTHED", required=True, help="run directory to write")
    smooth.add_argument(
        "--draws",
        type=whole_number(1),
        default=50,
        metavar="N",
        help="trajectories drawn backward for each target (default 50; a Gaussian belief needs none)",
    )
    smooth.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of these draws (default 0)"
    )
    smooth.add_argument(
        "--map",
        action="store_true",
        help="give the boxes of the most probable trajectory instead of the mean of each frame",
    )
    smooth.add_argument("--overwrite", action="store_true", help="replace an earlier run in --out")


FILES = ("png", "csv")


def _simulate(options: argparse.Namespace) -> int:
    """Draw trajectories, print how far they go, and write picture and CSV."""
    from bayesnet_track.engine.simulating import Simulation
    from bayesnet_track.engine.simulating import simulate as draw
    from bayesnet_track.engine.starts import check_given
    from bayesnet_track.graph.checks.queries import input_columns
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.numerics.boxes import centre_from_corner

    graph = load_graph(options.graph)
    if options.set:
        graph = set_values(graph.text, options.set, True, graph.masks, graph.calibrations)
    if (options.init is None) == (options.init_from is None):
        raise UsageError("give the box of the first frame: --init X,Y,W,H, or --init-from FILE")
    if options.init is not None:
        start = parse_start(options.init)
    else:
        start = read_start(Path(options.init_from), options.start, options.truth_format)
    for name in FILES:
        if getattr(options, name) is not None:
            check_free(Path(getattr(options, name)), options.overwrite)
    frame = _first_frame(options)
    with users_mistake():
        check_given(graph, [start], frame.width, frame.height)
    plate = graph.targets[start.plate or next(iter(graph.targets))]
    size, inputs = (frame.width, frame.height), input_columns(graph.spec)
    simulation = Simulation(options.frames, options.draws, options.seed, size, inputs)
    simulated = draw(plate, dict(graph.spec.constants), centre_from_corner(start.box), simulation)
    say(_summary(simulated, frame))
    if options.csv is not None:
        with users_output(Path(options.csv)):
            Path(options.csv).write_text(_csv_text(simulated, frame.index), encoding="utf-8")
        say(f"wrote {options.csv}")
    if options.png is not None:
        import cv2

        from bayesnet_track.view.overlay import draw_trajectories

        picture = cv2.imencode(".png", draw_trajectories(frame.image, simulated.boxes))[1].tobytes()
        with users_output(Path(options.png)):
            Path(options.png).write_bytes(picture)
        say(f"wrote {options.png}")
    return OK


def _csv_text(simulated: Simulated, first: int = 0) -> str:
    """A row for each trajectory and frame: corner box in px, then the further fields."""
    from bayesnet_track.numerics.boxes import corner_from_centre

    extra_fields = simulated.fields[4:]
    lines = [",".join(("trajectory", "frame", "x", "y", "w", "h", *extra_fields))]
    for number in range(simulated.states.shape[1]):
        for frame, state in enumerate(simulated.states[:, number]):
            values = [f"{value:.3f}" for value in corner_from_centre(state[:4])]
            for name, value in zip(extra_fields, state[4:], strict=True):
                is_mode = simulated.modes and name == extra_fields[-1]
                values.append(simulated.modes[int(value)] if is_mode else f"{value:.4f}")
            lines.append(",".join((str(number), str(first + frame), *values)))
    return "\n".join(lines) + "\n"


def _summary(simulated: Simulated, frame: Frame) -> str:
    """Table of how far the centre and the size have gone after some frames."""
    import numpy as np

    boxes, last_frame = simulated.boxes, len(simulated.boxes) - 1
    side = np.sqrt(boxes[..., 2] * boxes[..., 3])
    distance = np.hypot(*np.moveaxis(boxes[..., :2] - boxes[0, :, :2], -1, 0))
    x, y = boxes[..., 0], boxes[..., 1]
    at_border = ((x <= 0) | (y <= 0) | (x >= frame.width - 1) | (y >= frame.height - 1)).mean(axis=1)
    rows = ["frames  centre, px from the start     side, % of the first    centre at the"]
    rows += ["ahead        50 %         90 %            5 %       95 %          border"]
    for horizon in sorted({1, 5, 10, 25, 50, last_frame} & set(range(1, last_frame + 1))):
        median, upper = np.quantile(distance[horizon], (0.5, 0.9))
        small, large = 100 * np.quantile(side[horizon] / side[0], (0.05, 0.95))
        border = 100 * at_border[horizon]
        rows.append(f"{horizon:5d} {median:11.1f} {upper:12.1f} {small:14.0f} {large:10.0f} {border:14.0f} %")
    return "\n".join(rows)


def _first_frame(options: argparse.Namespace) -> Frame:
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.sources.sources import open_source

    window = (options.source, options.start, options.start + 1, options.allow_network)
    with open_source(*window, value_range=options.value_range) as source:
        for item in source:
            if isinstance(item, Frame):
                return item
        raise SourceError(source.description, f"no frame {options.start}", "a readable frame", "--start N")


def _add_simulate(commands: argparse._SubParsersAction[Any]) -> None:
    simulate = commands.add_parser(
        "simulate",
        help="draw trajectories from a graph's prior over the first frame",
        description="Draw how a graph expects a target to move before it has seen anything but the first "
        "box, and print how far: a check of its motion against what you know. No agent is evaluated.",
    )
    simulate.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    simulate.add_argument("--source", required=True, help="video file, folder of images, glob, or URL")
    simulate.add_argument("--init", metavar="[TYPE:]X,Y,W,H", help="box in the first frame")
    simulate.add_argument("--init-from", metavar="FILE", help="ground-truth file; its box of the first frame")
    add_truth_format(simulate)
    simulate.add_argument(
        "--start", type=whole_number(0), default=0, metavar="N", help="first frame (default 0)"
    )
    simulate.add_argument(
        "--frames", type=whole_number(1), default=50, metavar="N", help="frames ahead (default 50)"
    )
    simulate.add_argument(
        "--draws", type=whole_number(1), default=200, metavar="N", help="trajectories (default 200)"
    )
    simulate.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of the draws (default 0)"
    )
    simulate.add_argument("--png", metavar="FILE", help="write a picture of them on the first frame")
    simulate.add_argument("--csv", metavar="FILE", help="write them, one row per trajectory and frame")
    simulate.add_argument("--overwrite", action="store_true", help="replace existing files")
    simulate.add_argument("--allow-network", action="store_true", help="let the source be a URL")
    add_range_option(simulate)
    add_set_option(simulate)
    add_plugins(simulate)


COMMANDS = {
    "demo": (_add_demo, _demo), "resume": (_add_resume, _resume),
    "smooth": (_add_smooth, _smooth), "simulate": (_add_simulate, _simulate),
}  # fmt: skip
