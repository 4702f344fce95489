"""The command `diagnose`: what stands out in a run, and a key and a value to try."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import OK, UsageError, complain, say
from bayesnet_track.cli.diagnose.findings import Finding, find
from bayesnet_track.cli.diagnose.remedies import AGENT, MOTION, REMEDIES, ROOT

if TYPE_CHECKING:
    from bayesnet_track.runtime.recording.run_reader import Run


def diagnose(options: argparse.Namespace) -> int:
    """Print what stands out, target by target."""
    import json

    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(options.run, complain)
    if options.target is not None and options.target not in run.targets:
        there = ", ".join(run.targets) or "none"
        raise UsageError(f"{options.run}: no target {options.target!r}; there are {there}")
    shown = [advise(run, one) for one in find_all(run, options.target)]
    if options.json:
        say(json.dumps({"run": str(options.run), "findings": shown}))
        return OK
    for one in shown:
        say("\n".join(_lines(options.run, one)))
    if shown:
        say("compare a value with several seeds (run --seeds 5) before you keep it: one run may be chance")
    else:
        say(
            "nothing stands out. That a run agrees with itself does not show that the boxes are right: "
            f"`bayesnet-track score {options.run} --truth FILE` does"
        )
    return OK


def find_all(run: Run, target: str | None = None) -> Iterator[Finding]:
    """The findings of one target, or of all."""
    from bayesnet_track.journal.net.net import Switch

    for one in run.targets if target is None else (target,):
        switches = sum(isinstance(event, Switch) and event.target == one for event in run.events)
        for finding in find([line for line in run.metrics if line.target == one], switches):
            if finding.remedy != "stale" or "learn:" in run.graph_text:  # else nothing is meant to learn
                yield finding


def advise(run: Run, finding: Finding) -> dict[str, Any]:
    """A finding as plain data, with the key and value to try where the run's graph takes them."""
    from bayesnet_track.graph.text.change import ChangeError, change_graph
    from bayesnet_track.graph.text.messages import GraphError
    from bayesnet_track.observation.masks import AnyMask

    kind = run.kinds[finding.target]
    found = {"target": finding.target, "type": kind, "found": finding.what, "frame": finding.frame}
    if finding.remedy is None:
        return {**found, "symptom": None, "try": None, "key": None, "why": None}
    remedy = REMEDIES[finding.remedy]
    names = names_of(run.graph_text, kind, finding.agent)
    setting: str | None = remedy.setting(names)
    try:
        change_graph(run.graph_text, [str(setting)], masks=AnyMask())
    except (ChangeError, GraphError):
        setting = None
    return {
        **found,
        "symptom": remedy.symptom,
        "try": setting,
        "key": remedy.path(names),
        "why": remedy.why,
    }


def names_of(text: str, plate: str, agent: str | None = None) -> Mapping[str, str]:
    """What ROOT, MOTION, AGENT and CUE are in a graph."""
    import yaml

    nodes = yaml.safe_load(text)["targets"][plate]["nodes"]
    root = next(name for name, node in nodes.items() if "parent" not in node)
    motion = nodes[root].get("motion", MOTION)
    names = {ROOT: root, MOTION: motion if isinstance(motion, str) else next(iter(motion))}
    if agent in nodes:
        cue = nodes[agent]["agent"]
        names |= {AGENT: str(agent), "CUE": cue if isinstance(cue, str) else next(iter(cue))}
    return names


def _lines(run: str, one: Mapping[str, Any]) -> Iterator[str]:
    yield f"{one['type']} {one['target']}: {one['found']}"
    if one["try"] is not None:
        yield f"  try   bayesnet-track what-if {run} --set '{one['try']}'"
    elif one["key"] is not None:
        yield f"  key   {one['key']} (this graph does not take it as it is)"
    else:
        yield f"  try   bayesnet-track what-if {run} --seed 1"
        yield "        if another seed holds the target, chance decided; if not, no agent sees it there"
    if one["why"] is not None:
        yield f"        {one['why']}"
    if one["frame"] is not None:
        yield f"  look  bayesnet-track log {run} --why {one['frame']}"


def add_diagnose(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "diagnose",
        help="find what went wrong in a run, and which key to turn",
        description="Read the files of a run, report what stands out, and name a key and a value to try. "
        "Nothing is tracked again.",
    )
    parser.add_argument("run", metavar="RUN", help="run directory")
    parser.add_argument("--target", metavar="ID", help="only this target")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
