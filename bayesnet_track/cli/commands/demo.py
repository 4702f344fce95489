"""The command that tracks in a built-in scene: `demo`."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import (
    OK,
    say,
    users_mistake,
)
from bayesnet_track.cli.commands.start_boxes import run_folder
from bayesnet_track.cli.commands.tracking import track_source
from bayesnet_track.cli.commands.viewing import open_view
from bayesnet_track.cli.options.arguments import (
    add_plugins,
    add_set_option,
    add_view_options,
    set_values,
    whole_number,
)
from bayesnet_track.cli.options.runs import add_run_options

if TYPE_CHECKING:
    from bayesnet_track.runtime.live_view.view import LiveView


SCENE_GRAPHS = {
    "ball_between_children": "ball_between_children",
    "carried_box": "carried_box",
    "crowd": "crowd",
    "orange_and_gray": "orange_and_gray",
    "gray_square": "gray_square",
    "flying_ball": "kalman_ball",
    "person_and_board": "person_shape",
    "person_parts": "person_parts",
    "person_stereo": "person_stereo",
    "glass_wall": "person_stereo",
    "person_color_stereo": "person_color_stereo",
    "person_same_clothes": "person_same_clothes",
    "person_same_clothes_nearer": "person_same_clothes",
    "two_people_color_stereo_shape": "two_people_color_stereo_shape",
}
"""Scenes that do not run with the graph `two_squares`."""


def demo(options: argparse.Namespace) -> int:
    """Track in a built-in scene, then tell what happened and how well it went."""
    with open_view(options) as view:
        return _demo(options, view)


def _demo(options: argparse.Namespace, view: LiveView | None) -> int:
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.journal.text.explain import has_several_targets, kinds_of
    from bayesnet_track.journal.text.story import narrate_all
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.sources.scenes.library import SceneSource

    with users_mistake():
        source = SceneSource.named(options.scene, options.seed, options.end)
    scene = source.scene
    graph = load_graph(options.graph or SCENE_GRAPHS.get(options.scene, "two_squares"))
    if options.set:
        graph = set_values(graph.text, options.set, masks=graph.masks)
    # Only what an earlier demo wrote there is replaced without being asked to.
    out = run_folder(options.out or f"runs/{options.scene}")
    options.overwrite = options.overwrite or options.out is None
    starts = [
        Start(box, plate) for plate, box in (*scene.starts, *scene.part_starts) if plate in graph.targets
    ]
    starts = [] if has_births(graph) else starts or [Start(scene.start_box)]
    has_truth = bool(starts) and starts[0].box == scene.start_box
    code = track_source(options, graph, source, starts, out, video=True, view=view)
    directory = RunDirectory.open(out) if code == OK else None
    if options.json and directory is not None:
        scores = asdict(score_run(out, directory.truth, target="1")) if has_truth else {}
        say(json.dumps({"run": str(out), "scene": options.scene, "scores": scores}))
    if directory is None or options.quiet or options.json:
        return code
    events = list(read_events(directory.journal))
    name_target, kinds = has_several_targets(events), kinds_of(events)
    if not options.verbose:
        say("\nwhat was decided, and why:")
        for line in narrate_all(events, kinds, name_target):
            say(line)
    if has_truth:
        whose = f" of {kinds['1']} 1" if name_target else ""
        say(f"\nagainst the ground truth{whose}:")
        say(score_run(out, directory.truth, target="1").text(explained=True))
    explained_frame = min(29, source.expected_frames - 1)
    say(
        f"\nopen {directory.video} to watch it; `bayesnet-track report {out}` writes a page about it; "
        f"`bayesnet-track log {out} --why {explained_frame}` explains a frame"
    )
    return code


def add_demo(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
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
