"""The command `diagnose`: conspicuous findings of a run, each with a setting and a value to try."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import OK, UsageError, complain, say

if TYPE_CHECKING:
    from bayesnet_track.cli.findings import Finding
    from bayesnet_track.evaluate.motion_evidence import CameraCheck
    from bayesnet_track.journal.events.faults import Quarantined
    from bayesnet_track.numerics.arrays import Floats
    from bayesnet_track.runtime.recording.run_reader import Run


def find_all(run: Run, target: str | None = None) -> Iterator[Finding]:
    """The findings of one target, or of all."""
    from bayesnet_track.cli.findings import COLUMNS, find, find_failures, until_lost
    from bayesnet_track.journal.blocks import courses
    from bayesnet_track.journal.events.faults import Quarantined
    from bayesnet_track.journal.net import Switch

    switches: dict[str, int] = {}
    failures: dict[str, list[Quarantined]] = {}
    for event in run.events:
        if isinstance(event, Switch):
            switches[event.target] = switches.get(event.target, 0) + 1
        if isinstance(event, Quarantined):  # a switch, too
            failures.setdefault(event.target, []).append(event)
    targets = run.targets if target is None else (target,)
    yield from _identities(run, target)
    measured = courses(run.metrics, COLUMNS, targets)
    for target_id in targets:
        yield from find_failures(target_id, failures.get(target_id, ()))
        lines = measured[target_id]
        judged = until_lost(lines) if is_born(run, target_id) else lines
        for finding in find(judged, switches.get(target_id, 0)):
            if finding.remedy != "stale" or "learn:" in run.graph_text:  # else nothing is meant to learn
                yield finding


def _identities(run: Run, target: str | None) -> Iterator[Finding]:
    """Find what stands out in how identities follow each other, plate by plate."""
    from bayesnet_track.cli.identities import find_identities, identities_of
    from bayesnet_track.journal.blocks import courses

    types = _types(run.graph_text)
    if not any("birth" in plate for plate in types.values()):
        return
    identities = identities_of(run.events, courses(run.metrics, ("status", "box")))
    for plate in types:
        of_plate = [identity for identity in identities if run.kinds[identity.target] == plate]
        for finding in find_identities(of_plate, types, plate):
            if target is None or finding.target == target:
                yield finding


def advise(run: Run, finding: Finding) -> dict[str, Any]:
    """A finding as plain data, with the key and value to try where the run's graph takes them."""
    kind = run.kinds[finding.target]
    advice: dict[str, Any] = {
        "target": finding.target,
        "type": kind,
        "found": finding.what,
        "frame": finding.frame,
    }
    advice |= {
        "measure": finding.measure,
        "symptom": None,
        "try": None,
        "key": None,
        "why": None,
        "refused": None,
        "settings": [list(changes) for changes in finding.settings if not _refuses(run.graph_text, changes)],
    }
    if finding.settings:
        return advice | {"seed": False}
    if finding.remedy is None:
        # Another seed is worth a try where chance may have lost a target, not where its detections ended.
        return advice | {"seed": finding.measure != "failed" and not is_born(run, finding.target)}
    from bayesnet_track.cli.findings import MOTION, REMEDIES, ROOT

    remedy = REMEDIES[finding.remedy]
    names = names_of(run.graph_text, kind, finding.agent)
    if remedy.key.endswith(".sd_px") and "ground" in _types(run.graph_text)[kind].get("state", ()):
        factor = 2.0 if finding.remedy == "narrow" else 0.5
        metres, value = "sd", f"{{x: {factor:g}, y: {factor:g}}}"
        if names[MOTION] == "constant_velocity":
            motion = _types(run.graph_text)[kind]["nodes"][names[ROOT]]["motion"]
            metres, value = "sd_velocity", f"{factor * motion[names[MOTION]].get('sd_velocity', 1.0):g}"
        remedy = replace(remedy, key=remedy.key.replace("sd_px", metres), value=value)
    setting: str | None = remedy.setting(names)
    refused = _refused(run.graph_text, str(setting))
    return advice | {
        "symptom": remedy.symptom,
        "try": None if refused else setting,
        "key": remedy.path(names),
        "why": remedy.why,
        "refused": refused,
    }


@cache
def _refused(text: str, setting: str) -> str | None:
    """The reason that a graph does not take a setting; None if it does.

    What is wrong without the setting, too, does not count: cues of the user's own are not loaded here.
    """
    from bayesnet_track.graph.checks.cameras import AnyCalibration
    from bayesnet_track.graph.text.change import ChangeError, change_graph
    from bayesnet_track.graph.text.messages import GraphError
    from bayesnet_track.observation.image_files import AnyMask

    def mistakes(changes: Sequence[str]) -> list[str]:
        try:
            change_graph(text, changes, masks=AnyMask(), calibrations=AnyCalibration())
        except GraphError as error:
            return [mistake.found for mistake in error.errors]
        return []

    try:
        mistakes_now = mistakes([])
        return next((mistake for mistake in mistakes([setting]) if mistake not in mistakes_now), None)
    except ChangeError as error:
        return str(error)


def _refuses(text: str, changes: Sequence[str]) -> bool:
    """True if a graph does not take one of some settings."""
    return any(_refused(text, change) is not None for change in changes)


@cache
def _types(text: str) -> Mapping[str, Any]:
    import yaml

    types: Mapping[str, Any] = yaml.safe_load(text)["targets"]
    return types


def is_born(run: Run, target: str) -> bool:
    """True if detections start and end targets of this type."""
    return "birth" in _types(run.graph_text)[run.kinds[target]]


def names_of(text: str, plate: str, agent: str | None = None) -> Mapping[str, str]:
    """Names that ROOT, MOTION, AGENT and CUE stand for in a graph."""
    from bayesnet_track.cli.findings import AGENT, MOTION, ROOT

    nodes = _types(text)[plate]["nodes"]
    root = next(name for name, node in nodes.items() if "parent" not in node)
    motion = nodes[root].get("motion", MOTION)
    names = {ROOT: root, MOTION: motion if isinstance(motion, str) else next(iter(motion))}
    agent = agent if agent in nodes else str(agent).partition(".")[0]  # of one of several cameras
    if agent in nodes:
        cue = nodes[agent]["agent"]
        names |= {AGENT: str(agent), "CUE": cue if isinstance(cue, str) else next(iter(cue))}
    return names


def judge_cameras(run: Run) -> list[CameraCheck]:
    """The innovations of each camera that sees targets on the ground, in the order of the graph."""
    import numpy as np

    from bayesnet_track.journal.frame_columns import CAMERA_NUMBERS
    from bayesnet_track.journal.frame_file import FrameFile

    if "\ncameras:" not in run.graph_text:
        return []
    rows: dict[str, list[Floats]] = {}
    for columns in FrameFile(run.directory.frames).columns():
        for name, column in columns.items():
            if name.startswith("cameras/"):
                rows.setdefault(name.partition("/")[2], []).append(column.astype(np.float64))
    frames = {
        camera: dict(zip(CAMERA_NUMBERS, np.array(numbers).T, strict=True))
        for camera, numbers in rows.items()
        if len(numbers) >= FEW_STEPS
    }
    sums = {name: (numbers["targets"] - numbers["detections"]).sum() for name, numbers in frames.items()}
    misses = {name: max(float(count), 0.0) for name, count in sums.items()}
    total = max(sum(misses.values()), 1e-9)
    return [
        _check_camera(run, camera, frames[camera], misses[camera] / total)
        for camera in run.spec.cameras
        if camera in frames and frames[camera]["place_dof"].sum() > FEW_DEGREES
    ]


FEW_STEPS, FEW_DEGREES = 50, 30.0
"""Below so many steps, or degrees of freedom, nothing is said of a camera."""


def _check_camera(run: Run, camera: str, numbers: Mapping[str, Floats], missed: float) -> CameraCheck:
    import numpy as np

    from bayesnet_track.evaluate.motion_evidence import CameraCheck, MeanInnovation, NoiseRatio

    information = np.stack([numbers[name] for name in ("xx", "xy", "xy", "yy")], axis=1).reshape(-1, 2, 2)
    bias = MeanInnovation.estimate(np.stack([numbers["x_px"], numbers["y_px"]], axis=1), information)
    (x_px, y_px), (x_sd, y_sd) = bias.px.tolist(), bias.sd.tolist()
    place = NoiseRatio.estimate(
        numbers["place_nis"] - bias.squared, numbers["place_dof"], numbers["place_noise"]
    )
    size = NoiseRatio.estimate(numbers["size_nis"], numbers["size_dof"], numbers["size_noise"])
    sums = float(numbers["detections"].sum()), float(numbers["targets"].sum())
    check = CameraCheck(camera, *sums, missed, x_px, x_sd, y_px, y_sd, place, size, bias.memory)
    return replace(check, settings=tuple(_settings_of(run, check)))


def _settings_of(run: Run, check: CameraCheck) -> Iterator[str]:
    """Settings of the camera's detections, or of the motion, with which innovations would be as stated.

    Where places alone are not, it is the motion: an error of detections shows in sizes, too.
    """
    ratios = {"place": check.place, "size": check.size}
    wrong = {part: ratio for part, ratio in ratios.items() if not ratio.is_right}
    from bayesnet_track.evaluate.motion_evidence import CORRELATED

    if check.memory > CORRELATED:
        wrong = {part: ratio for part, ratio in wrong.items() if ratio.ratio > 1.0}
    for plate in _types(run.graph_text).values():
        nodes = plate["nodes"]
        named = {name: node["camera"] for name, node in nodes.items() if "camera" in node}
        lists = {name: value if isinstance(value, list) else [value] for name, value in named.items()}
        views = [name for name, cameras in lists.items() if check.camera in cameras]
        root = next(name for name, node in nodes.items() if "parent" not in node)
        motion = nodes[root].get("motion")
        speed = motion.get("constant_velocity", {}).get("sd_velocity") if isinstance(motion, dict) else None
        for name in (name for name, node in nodes.items() if views and node.get("parent") in views):
            agent = nodes[name].get("agent")
            detection = agent.get("detection") or {} if isinstance(agent, dict) else {}
            if "place" in wrong and "size" not in wrong and speed:
                factor = check.place.factor_of(1.0 - check.place.noise)
                yield f"{root}.motion.constant_velocity.sd_velocity={speed * factor:.2g}"
                continue
            for part, ratio in wrong.items():
                for key in (f"sd_{part}", f"sd_{part}_px"):
                    if value := detection.get(key):
                        yield f"{name}.agent.detection.{key}={value * ratio.factor_of(ratio.noise):.2g}"
    source = run.spec.cameras[check.camera]
    for mean, sd in ((check.x_px, check.x_sd), (check.y_px, check.y_sd)):
        stated = 0.0 if source.bias_px is None else source.bias_px.sd
        if abs(mean) > 3.0 * sd and abs(mean) > max(stated, 1.0):
            yield f"cameras.{check.camera}.bias_px.sd={abs(mean):.2g}"


ONE_BY_ONE = 3
"""Of more targets than this, findings that are alike are printed once."""
SHOWN_TARGETS = 8
UNTRIED = (
    "these values are untested, and a value that helps one video may harm another: `what-if` tracks with it "
    "and compares. Compare it with several seeds (run --seeds 5) before you keep it: one run may be chance"
)


def _diagnose(options: argparse.Namespace) -> int:
    """Print what stands out, target by target."""
    import json
    from shlex import quote

    from bayesnet_track.journal.events.cameras import CameraKnocked
    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(options.run, complain)
    if options.target is not None and options.target not in run.targets:
        targets = ", ".join(run.targets) or "none"
        raise UsageError(f"{options.run}: no target {options.target!r}; there are {targets}")
    findings = list(find_all(run, options.target))
    knocks = [event for event in run.events if options.target is None and isinstance(event, CameraKnocked)]
    checks = [] if options.target is not None else judge_cameras(run)
    if options.json:
        cameras = [asdict(event) for event in knocks]
        innovations = [asdict(check) for check in checks]
        findings_json = [advise(run, finding) for finding in findings]
        tables = {"findings": findings_json, "cameras": cameras, "innovations": innovations}
        say(json.dumps({"run": str(options.run), **tables}))
        return OK
    if options.try_settings:
        return _try_all(options, run, findings)
    for event in knocks:
        say(event.describe())
        say(f"  look  bayesnet-track log {options.run} --why {event.frame}")
    counts = Counter(event.camera for event in knocks)
    often = [camera for camera, count in counts.items() if count > 1]
    if len(often) > 1:
        say(
            f"cameras {', '.join(often)} are found off again and again: are their files (--source, "
            "--detections) or their calibrations exchanged?"
        )
    tried = False
    for check in checks:
        say(check.describe())
        if check.settings:
            tried = True
            sets = " ".join(f"--set {quote(setting)}" for setting in check.settings)
            say(f"  try   bayesnet-track what-if {options.run} {sets}")
    for group in _grouped(run, findings):
        advice = advise(run, group[0])
        tried |= advice["try"] is not None or bool(advice["settings"])
        say("\n".join(_lines(options.run, advice)))
        if len(group) > 1:
            say("\n".join(_other_targets(options.run, [finding.target for finding in group[1:]])))
    if tried:
        say(UNTRIED)
    elif not findings and not knocks and not checks:
        say(
            "nothing stands out. That a run agrees with itself does not show that the boxes are right: "
            f"`bayesnet-track score {options.run} --truth FILE` does"
        )
    return OK


def _try_all(options: argparse.Namespace, run: Run, findings: Sequence[Finding]) -> int:
    """Track again with each proposed setting of identities, and print what becomes of them."""
    import tempfile
    from pathlib import Path

    from bayesnet_track.cli.arguments import set_values
    from bayesnet_track.cli.commands.compare import check_unchanged, earlier_run, repeat
    from bayesnet_track.runtime.recording.run_reader import open_run

    proposed = [(finding, changes) for finding in findings for changes in finding.settings]
    proposed = [(finding, changes) for finding, changes in proposed if not _refuses(run.graph_text, changes)]
    if not proposed:
        say("no setting to try: no identity of this run goes on as another")
        return OK
    run, recipe = earlier_run(options.run)
    check_unchanged(options.run, recipe)
    masks, cameras = recipe.read_masks(), recipe.read_calibrations(run.spec)
    for plate in dict.fromkeys(run.kinds[finding.target] for finding, _ in proposed):
        say(f"{plate}: {_count_identities(run, plate)}")
    for finding, changes in proposed:
        plate = run.kinds[finding.target]
        graph = set_values(run.graph_text, list(changes), True, masks, cameras)
        with tempfile.TemporaryDirectory() as folder, recipe.opened() as source:
            run_folder = Path(folder) / "run"
            for _ in repeat(run, recipe, source, graph, run_folder, seed=recipe.seed):
                pass
            counted = _count_identities(open_run(run_folder, complain), plate)
        say(f"  {' '.join(changes)}: {counted}")
    return OK


def _count_identities(run: Run, plate: str) -> str:
    """`9 identities, 6 of which go on as another, 12 frames long (median)`."""
    from bayesnet_track.cli.identities import identities_of, successors_of
    from bayesnet_track.journal.blocks import courses
    from bayesnet_track.journal.text.wording import plural

    identities = identities_of(run.events, courses(run.metrics, ("status", "box")))
    identities = [identity for identity in identities if run.kinds[identity.target] == plate]
    if not identities:
        return "no identity"
    frames = sorted(identity.frames for identity in identities)
    count = len(identities)
    return (
        f"{count} identit{'y' if count == 1 else 'ies'}, {len(successors_of(identities))} of which go on as "
        f"another, {plural(frames[len(frames) // 2], 'frame')} long (median)"
    )


def _grouped(run: Run, findings: Sequence[Finding]) -> Iterator[Sequence[Finding]]:
    """Findings that are alike: one by one for a few targets, together for many."""
    groups: dict[tuple[str, ...], list[Finding]] = {}
    is_many = len({finding.target for finding in findings}) > ONE_BY_ONE
    for index, finding in enumerate(findings):
        key = (
            (run.kinds[finding.target], finding.measure, str(finding.remedy), str(finding.agent))
            if is_many
            else (str(index),)
        )
        groups.setdefault(key, []).append(finding)
    yield from groups.values()


def _other_targets(run: str, targets: Sequence[str]) -> Iterator[str]:
    from bayesnet_track.journal.text.wording import plural

    some = ", ".join(targets[:SHOWN_TARGETS]) + (", ..." if len(targets) > SHOWN_TARGETS else "")
    yield f"  also  {plural(len(targets), 'other target')}: {some}"
    yield f"        bayesnet-track diagnose {run} --target {targets[0]}"


def _lines(run: str, advice: Mapping[str, Any]) -> Iterator[str]:
    from shlex import quote

    yield f"{advice['type']} {advice['target']}: {advice['found']}"
    if advice["try"] is not None:
        yield f"  try   bayesnet-track what-if {run} --set '{advice['try']}'"
    elif advice["key"] is not None:
        yield f"  key   {advice['key']}, but not in this graph: {advice['refused']}"
    elif advice["seed"]:
        yield f"  try   bayesnet-track what-if {run} --seed 1"
        yield "        if another seed holds the target, chance decided; if not, no agent sees it there"
    for changes in advice["settings"]:
        sets = " ".join(f"--set {quote(change)}" for change in changes)
        yield f"  try   bayesnet-track what-if {run} {sets}"
    if advice["why"] is not None:
        yield f"        {advice['why']}"
    if advice["frame"] is not None:
        yield f"  look  bayesnet-track log {run} --why {advice['frame']}"


def _add_diagnose(commands: argparse._SubParsersAction[Any]) -> None:
    parser = commands.add_parser(
        "diagnose",
        help="find what went wrong in a run, and which setting to change",
        description="Read the files of a run, report what stands out, and name a key and a value to try. "
        "Only --try tracks again.",
    )
    parser.add_argument("run", metavar="RUN", help="run directory")
    parser.add_argument("--target", metavar="ID", help="only this target")
    parser.add_argument(
        "--try",
        dest="try_settings",
        action="store_true",
        help="where identities switch: track again with each setting that may prevent it, and count",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


COMMANDS = {"diagnose": (_add_diagnose, _diagnose)}
