"""Commands that compare two runs: `compare`, and `what-if`, which tracks again with something changed."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    BAD_OUTPUT,
    INCOMPLETE,
    OK,
    TRUTH_LINES,
    UsageError,
    add_plugins,
    add_set_option,
    add_truth_format,
    check_free,
    complain,
    free_folder,
    say,
    set_values,
    users_file,
    users_mistake,
    users_output,
    whole_number,
)

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.graph.spec import AgentChoice, GraphSpec
    from bayesnet_track.journal.compare import Comparison
    from bayesnet_track.journal.compare_measures import Total
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.runtime.recording.run_reader import Run
    from bayesnet_track.runtime.results import Result


def _compare(options: argparse.Namespace) -> int:
    """Tell where two runs part, and why."""
    from bayesnet_track.runtime.recording.run_reader import open_run

    check_page(options)
    first, second = open_run(options.first, complain), open_run(options.second, complain)
    differences = sources_apart(first, second)
    if differences and not options.force:
        raise UsageError(
            f"{first.name} and {second.name} are runs of different sources: {'; '.join(differences)}; frames "
            "of the same number do not show the same image (--force compares them all the same)"
        )
    return show_comparison(first, second, options)


def check_page(options: argparse.Namespace) -> None:
    """Refuse to write the page over another file, before anything is done for it; raises OutputError."""
    if options.html is not None:
        check_free(Path(options.html), options.overwrite)


def sources_apart(first: Run, second: Run) -> list[str]:
    """Signs that two runs did not see the same pictures; empty without any."""
    import numpy as np

    from bayesnet_track.journal.blocks import Blocks

    a, b = first.started, second.started
    differences = _origins_apart(first, second)
    if (a.width, a.height, a.has_color) != (b.width, b.height, b.has_color):
        sizes = [f"{event.width}x{event.height}{'' if event.has_color else ' gray'}" for event in (a, b)]
        differences.append(" and ".join(sizes))
    frames = [Blocks(run.metrics, ()).all_frames for run in (first, second)]
    if not differences and not np.isin(frames[0], frames[1]).any():
        differences.append("they have no frame in common")
    return differences


def _origins_apart(first: Run, second: Run) -> list[str]:
    """By what the sources held where both recipes tell it, else by their names."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError

    by_name = [run.started.source for run in (first, second)]
    try:
        a, b = (Recipe.read(run.directory).origin for run in (first, second))
    except RecipeError:
        same = os.path.normpath(by_name[0]) == os.path.normpath(by_name[1])
        return [] if same else [" and ".join(by_name)]
    if a.kind == b.kind == "scene":
        scenes = [f"{origin.description} of seed {origin.seed}" for origin in (a, b)]
        return [] if scenes[0] == scenes[1] else [" and ".join(scenes)]
    if a.kind != b.kind:
        return [f"{by_name[0]} ({a.kind}) and {by_name[1]} ({b.kind})"]
    if a.fingerprint and b.fingerprint:
        parts = [part for part in a.fingerprint if a.fingerprint[part] != b.fingerprint.get(part)]
        return [f"{part} held {a.fingerprint[part]} and {b.fingerprint.get(part)}" for part in parts]
    return [] if by_name[0] == by_name[1] else [" and ".join(by_name)]


def show_comparison(first: Run, second: Run, options: argparse.Namespace) -> int:
    """Print the comparison of two runs, and write its page where --html asks for one."""
    from dataclasses import replace

    from bayesnet_track.graph.text.write import differences
    from bayesnet_track.journal.compare import compare as compare_runs
    from bayesnet_track.journal.text.compare_text import SHOWN_MOMENTS, compare_text, settings_apart

    compared = compare_runs(first, second)
    scores = _scores(first, second, compared, options)
    compared = replace(compared, totals=(*compared.totals, *_evidence(first, second, compared), *scores))
    settings = settings_apart(first.started, second.started)
    settings += [str(difference) for difference in differences(first.graph_text, second.graph_text)]
    if options.html is not None:
        from bayesnet_track.view.compare_page import compare_page

        page = compare_page(first, second, compared, settings, pictures=_pictures(first, second, compared))
        with users_output(Path(options.html)):
            Path(options.html).write_text(page, encoding="utf-8")
    if options.json:
        say(_as_json(first, second, compared, settings))
    else:
        limit = 2**62 if options.all else SHOWN_MOMENTS
        hint = "; --all lists them all, --html draws them"
        say(compare_text(first, second, compared, settings, limit, hint))
    if options.html is not None:
        complain(f"wrote {options.html}")
    return OK


def _pictures(first: Run, second: Run, compared: Comparison) -> list[str]:
    """The frames in which they part, as figures; none, with a word, where the images cannot be had."""
    from bayesnet_track.runtime.recording.run_reader import pictures_of
    from bayesnet_track.view.compare_charts import draw_pictures, telling_frames

    telling = telling_frames(compared)
    if not telling:
        return []
    span = telling[0].frame, telling[-1].frame
    with pictures_of(first.directory, first.started, *span) as (pictures, missing):
        if pictures is None:
            complain(f"{first.name}: the page has no pictures: {missing}")
            return []
        return list(draw_pictures(pictures.images, telling, first, second))


def _evidence(first: Run, second: Run, compared: Comparison) -> list[Total]:
    """Totals by which graph explains the video better, where both have the same agents.

    Agents that measure a density are the same with other errors, too; beside it stands how well each of the
    sensors that both have was predicted.
    """
    from bayesnet_track.graph.spec import AgentNode

    agents = [
        {
            (plate, name): _evidence_of(node.agent)
            for plate, target in run.spec.targets.items()
            for name, node in target.nodes.items()
            if isinstance(node, AgentNode)
        }
        for run in (first, second)
    ]
    return [*([compared.evidence] if agents[0] == agents[1] else []), *compared.predictive]


def _evidence_of(agent: AgentChoice) -> tuple[str, Mapping[str, Any]]:
    """The cue and its parameters, without those that its density depends on."""
    from bayesnet_track.observation.cue import installed_cues

    declared = installed_cues([agent.cue]).get(agent.cue)
    is_density = declared is not None and declared.measures and not declared.reads_detection
    left_out = {"sd", "floor"} if is_density else set()
    return agent.cue, {key: value for key, value in agent.parameters.items() if key not in left_out}


def _scores(first: Run, second: Run, compared: Comparison, options: argparse.Namespace) -> list[Total]:
    """Figures against the truth: of all targets where it is MOT, else of the first one."""
    from bayesnet_track.evaluate.runs import score_run, score_several
    from bayesnet_track.evaluate.truth import is_mot
    from bayesnet_track.journal.compare_measures import Total

    truth_path, form = options.truth, options.truth_format
    truth = Path(truth_path) if truth_path is not None else first.directory.truth
    if truth_path is None and not truth.is_file():
        return []
    runs = (first, second)
    with users_file("--truth", f"{TRUTH_LINES}, or MOT lines"):
        has_several = is_mot(truth, form)
    with users_mistake():
        if has_several:
            mot = [score_several(run.directory.path, truth, form) for run in runs]
            return [
                Total("MOTA", mot[0].mota, mot[1].mota, False),
                Total("IDF1", mot[0].idf1, mot[1].idf1, False),
                Total("HOTA", mot[0].hota, mot[1].hota, False),
                Total("identity switches", mot[0].idsw, mot[1].idsw, True),
            ]
        if not compared.pairs:
            return []
        pair = compared.pairs[0]
        scores = [
            score_run(run.directory.path, truth, name, form) for run, name in zip(runs, pair, strict=True)
        ]
    whose = f", target {pair[0]}" if len(first.targets) > 1 else ""
    wrong, doubted = zip(*(run_score.misjudged for run_score in scores), strict=True)
    return [
        Total(f"AUC{whose}", scores[0].auc, scores[1].auc, False),
        Total(f"AUC, lost counts as 0{whose}", scores[0].auc_strict, scores[1].auc_strict, False),
        Total(f"within 20 px{whose}", scores[0].precision20, scores[1].precision20, False),
        Total(f"mean IoU{whose}", scores[0].mean_iou, scores[1].mean_iou, False),
        Total(f"times off target{whose}", scores[0].lost_episodes, scores[1].lost_episodes, True),
        Total(f"frames `tracking` at an IoU up to 0.5{whose}", wrong[0], wrong[1], True),
        Total(f"frames not `tracking` at an IoU above 0.5{whose}", doubted[0], doubted[1], True),
    ]


def _as_json(first: Run, second: Run, compared: Comparison, settings: list[str]) -> str:
    import json

    from bayesnet_track.journal.codec import to_json

    return json.dumps(
        {
            "first": first.name,
            "second": second.name,
            "settings": settings,
            "pairs": compared.pairs,
            "alone": compared.alone,
            "agreed": compared.agreed,
            "first_apart": compared.first_apart,
            "moments": [
                {
                    "frame": moment.frame,
                    "target": moment.target,
                    "pair": moment.pair,
                    "node": moment.node,
                    "first": [json.loads(to_json(event)) for event in moment.first],
                    "second": [json.loads(to_json(event)) for event in moment.second],
                }
                for moment in compared.moments
            ],
            "last_frames": compared.last_frames,
            "totals": {total.name: (total.first, total.second) for total in compared.totals},
            "distances": [
                {
                    "pair": pair,
                    "frames": [*zip(line.frame.tolist(), line.px.tolist(), line.iou.tolist(), strict=True)],
                }
                for pair, line in compared.distances.items()
            ],
        }
    )


def _add_compare(commands: argparse._SubParsersAction[Any]) -> None:
    compare = commands.add_parser(
        "compare", help="show where the decisions of two runs differ, why, and what that cost or saved"
    )
    compare.add_argument("first", metavar="RUN", help="run directory, called A")
    compare.add_argument("second", metavar="RUN", help="run directory over the same source, called B")
    add_comparison_options(compare)
    compare.add_argument("--overwrite", action="store_true", help="replace the file of --html if it exists")
    compare.add_argument("--force", action="store_true", help="compare even runs of different sources")


def add_comparison_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of how a comparison is printed."""
    parser.add_argument("--html", metavar="FILE", help="also write the comparison as one offline page")
    parser.add_argument(
        "--truth", metavar="FILE", help="ground truth to score both with (default: truth.txt of the first)"
    )
    add_truth_format(parser)
    parser.add_argument("--all", action="store_true", help="list every difference, not only the first few")
    parser.add_argument("--json", action="store_true", help="print it as JSON")


def _what_if(options: argparse.Namespace) -> int:
    """Run again, then compare."""
    from bayesnet_track.runtime.recording.manifest import add_output
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    check_page(options)
    first, recipe = earlier_run(options.run)
    check_unchanged(options.run, recipe, options.force)
    if options.no_adaptation:
        _require_adaptation(first.spec)
    masks = recipe.read_masks()
    cameras = recipe.read_calibrations(first.spec)
    graph = set_values(first.graph_text, options.set, not options.no_adaptation, masks, cameras)
    folder = _folder(options)
    if folder.resolve() == first.directory.path.resolve():
        raise UsageError(f"--out {folder}: that is the run itself; give another folder")
    code = _track_again(options, first, recipe, graph, folder)
    if code not in (OK, INCOMPLETE):
        return code
    second = RunDirectory.open(folder)
    if first.directory.truth.is_file() and not second.truth.exists():
        try:
            shutil.copyfile(first.directory.truth, second.truth)
            add_output(second, "truth")
        except OSError as error:
            complain(f"{second.truth}: cannot write: {error.strerror}")
            return BAD_OUTPUT
    return show_comparison(first, open_run(folder, complain), options) or code


def earlier_run(path: str) -> tuple[Run, Recipe]:
    """The run to repeat, and how it was made; raises UsageError if it cannot be repeated."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError

    try:
        run = open_run(path, complain)
        # Its repetition would not be smoothed: the two would differ even with nothing changed.
        if run.started.smoothed:
            raise UsageError(f"{path}: it has been smoothed; use the run that it was made from")
        recipe = Recipe.read(run.directory)
    except (RunDirectoryError, RecipeError) as error:
        raise UsageError(str(error)) from error
    if recipe.only_once is not None:
        raise UsageError(f"{path}: it cannot be run again: {recipe.only_once}")
    return run, recipe


def check_unchanged(path: str, recipe: Recipe, is_forced: bool = False) -> None:
    """Refuse a run whose source, cues or files have changed since; raises UsageError."""
    from bayesnet_track.runtime.checkpoints.standing import check_cues, check_files

    with users_mistake():
        changes = recipe.origin.changes()
    if changes and not is_forced:
        listed = "; ".join(changes)
        raise UsageError(f"{path}: the source has changed: {listed} (--force goes on all the same)")
    if not is_forced:
        check_cues(recipe, ())
        check_files(recipe)


def _folder(options: argparse.Namespace) -> Path:
    """The folder to write to: --out, else the first of RUN-what-if, RUN-what-if-2, ... that is free."""
    if options.out:
        return Path(options.out)
    return free_folder(f"{str(options.run).rstrip('/')}-what-if", options.overwrite)


def _track_again(
    options: argparse.Namespace, first: Run, recipe: Recipe, graph: CheckedGraph, folder: Path
) -> int:
    """The run of a recipe with another graph or seed; what came from outside then comes again."""
    from bayesnet_track.cli.following import Narrator, follow_run, users_start
    from bayesnet_track.runtime.results import Summary

    summary, seed = Summary(), recipe.seed if options.seed is None else options.seed
    sinks = [Narrator()] if options.verbose else []
    with recipe.opened() as source:
        with users_start():
            results = repeat(
                first, recipe, source, graph, folder, seed=seed, overwrite=options.overwrite, sinks=sinks,
                summary=summary,
            )  # fmt: skip
        return follow_run(options, results, summary, source.expected_frames, folder)


def repeat(
    first: Run, recipe: Recipe, source: Any, graph: CheckedGraph, folder: Path, **settings: Any
) -> Generator[Result, None, None]:
    """Track the source of an earlier run with another graph; `settings` are those of `track`."""
    from bayesnet_track.runtime.session import track

    detections = {camera: file.place for camera, file in recipe.detection_files.items()}
    return track(
        graph,
        source,
        list(recipe.starts) or None,
        out=folder,
        detections=detections.get("") or detections or None,
        inputs=first.directory.inputs if first.directory.inputs.is_file() else None,
        max_side=recipe.max_side,
        all_hypotheses="hypotheses" in recipe.optional,
        tracks_csv="csv" in recipe.optional,
        **settings,
    )


def _require_adaptation(spec: GraphSpec) -> None:
    """Refuse `--no-adaptation` for a graph of which nothing switches an agent; raises UsageError."""
    from bayesnet_track.graph.settings.net import ADAPTATION

    if any(node.adapts for target in spec.targets.values() for node in target.nodes.values()):
        return
    *keys, final_key = (f"`{key}`" for kind in ADAPTATION.values() for key in kind)
    raise UsageError(
        f"--no-adaptation: no node of {spec.name} has {', '.join(keys)} or {final_key}: "
        "all its agents are always on"
    )


def _add_what_if(commands: argparse._SubParsersAction[Any]) -> None:
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


COMMANDS = {"compare": (_add_compare, _compare), "what-if": (_add_what_if, _what_if)}
