"""The command `what-if`: an earlier run again with something changed, and the comparison of the two."""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import BAD_OUTPUT, INCOMPLETE, OK, UsageError, complain, users_mistake
from bayesnet_track.cli.commands.compare import add_comparison_options
from bayesnet_track.cli.options.arguments import add_plugins, add_set_option, set_values, whole_number

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.graph.spec import GraphSpec
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.runtime.recording.run_reader import Run


def what_if(options: argparse.Namespace) -> int:
    """Run again, then compare."""
    from bayesnet_track.cli.commands.compare import check_page, show_comparison
    from bayesnet_track.runtime.checkpoints.standing import check_cues, check_files
    from bayesnet_track.runtime.recording.manifest import add_output
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    check_page(options)
    first, recipe = _earlier_run(options)
    with users_mistake():
        changes = recipe.origin.changes()
    if changes and not options.force:
        raise UsageError(
            f"{options.run}: the source has changed: {'; '.join(changes)} (--force goes on all the same)"
        )
    if not options.force:
        check_cues(recipe, ())
        check_files(recipe)
    if options.no_adaptation and not adapts(first.spec):
        raise UsageError(
            f"--no-adaptation: no node of {first.spec.name} has `adapt`, `active` or `self_check`: "
            "all its agents are always on"
        )
    masks = recipe.read_masks()
    graph = set_values(first.graph_text, options.set, not options.no_adaptation, masks)
    out = _folder(options)
    if out.resolve() == first.directory.path.resolve():
        raise UsageError(f"--out {out}: that is the run itself; give another folder")
    code = _track_again(options, first, recipe, graph, out)
    if code not in (OK, INCOMPLETE):
        return code
    second = RunDirectory.open(out)
    if first.directory.truth.is_file() and not second.truth.exists():
        try:
            shutil.copyfile(first.directory.truth, second.truth)
            add_output(second, "truth")
        except OSError as error:
            complain(f"{second.truth}: cannot write: {error.strerror}")
            return BAD_OUTPUT
    return show_comparison(first, open_run(out, complain), options) or code


def _earlier_run(options: argparse.Namespace) -> tuple[Run, Recipe]:
    """The run to repeat, and how it was made; raises UsageError if it cannot be repeated."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError

    try:
        run = open_run(options.run, complain)
        # Its repetition would not be smoothed: the two would differ even with nothing changed.
        if run.started.smoothed:
            raise UsageError(f"{options.run}: it has been smoothed; use the run that it was made from")
        recipe = Recipe.read(run.directory)
    except (RunDirectoryError, RecipeError) as error:
        raise UsageError(str(error)) from error
    if recipe.only_once is not None:
        raise UsageError(f"{options.run}: it cannot be run again: {recipe.only_once}")
    return run, recipe


def _folder(options: argparse.Namespace) -> Path:
    """Where to write: --out, else the first of RUN-what-if, RUN-what-if-2, ... that is free."""
    if options.out:
        return Path(options.out)
    first = f"{str(options.run).rstrip('/')}-what-if"
    names = itertools.chain([first], (f"{first}-{number}" for number in itertools.count(2)))
    return Path(next(name for name in names if options.overwrite or not os.path.lexists(name)))


def _track_again(
    options: argparse.Namespace, first: Run, recipe: Recipe, graph: CheckedGraph, out: Path
) -> int:
    """The run of a recipe with another graph or seed; what came from outside then comes again."""
    from bayesnet_track.cli.following import Narrator, follow, users_start
    from bayesnet_track.runtime.results import Summary
    from bayesnet_track.runtime.session import track

    summary = Summary()
    with recipe.opened() as source:
        with users_start():
            results = track(
                graph,
                source,
                list(recipe.starts) or None,
                out=out,
                seed=recipe.seed if options.seed is None else options.seed,
                detections=None if recipe.detections is None else recipe.detections.place,
                inputs=first.directory.inputs if first.directory.inputs.is_file() else None,
                max_side=recipe.max_side,
                all_hypotheses="hypotheses" in recipe.optional,
                overwrite=options.overwrite,
                sinks=[Narrator()] if options.verbose else [],
                summary=summary,
            )
        return follow(options, results, summary, source.expected_frames, out)


def adapts(spec: GraphSpec) -> bool:
    """Whether anything in the graph switches agents, or begins with one off."""
    nodes = [node for target in spec.targets.values() for node in target.nodes.values()]
    return any(getattr(node, "adapt", None) or getattr(node, "self_check", None) for node in nodes) or any(
        getattr(node, "active", True) is not True for node in nodes
    )


def as_what_if(arguments: Sequence[str]) -> list[str]:
    """`run --what-if RUN ...` as `what-if RUN ...`; other arguments as they are.

    >>> as_what_if(["run", "--what-if", "runs/mine", "--seed", "1"])
    ['what-if', 'runs/mine', '--seed', '1']
    """
    if list(arguments[:1]) != ["run"]:
        return list(arguments)
    for place, argument in enumerate(arguments):
        if argument == "--what-if":
            return ["what-if", *arguments[1:place], *arguments[place + 1 :]]
        if argument.startswith("--what-if="):
            run = argument.partition("=")[2]
            return ["what-if", *arguments[1:place], run, *arguments[place + 1 :]]
    return list(arguments)


def add_what_if(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    what_if = commands.add_parser(
        "what-if",
        help="repeat a run with other thresholds or another seed, and compare",
        description="Repeat a run over the same source and start boxes with something changed, and report "
        "where the two differ.",
    )
    what_if.add_argument("run", metavar="RUN", help="run directory")
    add_set_option(what_if)
    what_if.add_argument("--no-adaptation", action="store_true", help="all agents always on")
    what_if.add_argument(
        "--seed", type=whole_number(0), metavar="N", help="another seed (default: that of the run)"
    )
    what_if.add_argument(
        "-o",
        "--out",
        metavar="DIR",
        help="run directory to write (default RUN-what-if, or RUN-what-if-2, ... if that exists)",
    )
    what_if.add_argument(
        "--overwrite",
        action="store_true",
        help="replace an earlier run in --out (without --out, in RUN-what-if), and the file of --html",
    )
    what_if.add_argument(
        "--force",
        action="store_true",
        help="continue although the source, or a cue, mask or model file, has changed since",
    )
    what_if.add_argument("-q", "--quiet", action="store_true", help="no progress line")
    what_if.add_argument("-v", "--verbose", action="store_true", help="every decision when it is made")
    what_if.add_argument("--log-json", action="store_true", help="progress as JSON lines, on stderr")
    add_plugins(what_if)
    add_comparison_options(what_if)
