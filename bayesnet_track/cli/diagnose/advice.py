"""What stands out in a run, with the key and the value to try."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.diagnose.findings import Finding, find, find_failures, until_lost
from bayesnet_track.cli.diagnose.remedies import AGENT, MOTION, REMEDIES, ROOT

if TYPE_CHECKING:
    from bayesnet_track.journal.events.faults import Quarantined
    from bayesnet_track.journal.metrics import FrameMetrics
    from bayesnet_track.runtime.recording.run_reader import Run


def find_all(run: Run, target: str | None = None) -> Iterator[Finding]:
    """The findings of one target, or of all."""
    from bayesnet_track.journal.events.faults import Quarantined
    from bayesnet_track.journal.net.net import Switch

    lines: dict[str, list[FrameMetrics]] = {}
    switches: dict[str, int] = {}
    failures: dict[str, list[Quarantined]] = {}
    for line in run.metrics:
        lines.setdefault(line.target, []).append(line)
    for event in run.events:
        if isinstance(event, Switch):
            switches[event.target] = switches.get(event.target, 0) + 1
        if isinstance(event, Quarantined):  # a switch, too
            failures.setdefault(event.target, []).append(event)
    for one in run.targets if target is None else (target,):
        yield from find_failures(one, failures.get(one, ()))
        own = lines.get(one, [])
        shown = until_lost(own) if is_born(run, one) else own
        for finding in find(shown, switches.get(one, 0)):
            if finding.remedy != "stale" or "learn:" in run.graph_text:  # else nothing is meant to learn
                yield finding


def advise(run: Run, finding: Finding) -> dict[str, Any]:
    """A finding as plain data, with the key and value to try where the run's graph takes them."""
    kind = run.kinds[finding.target]
    found = {"target": finding.target, "type": kind, "found": finding.what, "frame": finding.frame}
    found |= {
        "measure": finding.measure,
        "symptom": None,
        "try": None,
        "key": None,
        "why": None,
        "refused": None,
    }
    if finding.remedy is None:
        # Another seed is worth a try where chance may have lost a target, not where its detections ended.
        return found | {"seed": finding.measure != "failed" and not is_born(run, finding.target)}
    remedy = REMEDIES[finding.remedy]
    names = names_of(run.graph_text, kind, finding.agent)
    setting: str | None = remedy.setting(names)
    refused = _refused(run.graph_text, str(setting))
    return found | {
        "symptom": remedy.symptom,
        "try": None if refused else setting,
        "key": remedy.path(names),
        "why": remedy.why,
        "refused": refused,
    }


@cache
def _refused(text: str, setting: str) -> str | None:
    """Why a graph does not take a setting; None if it does.

    What is wrong without the setting, too, does not count: cues of the user's own are not loaded here.
    """
    from bayesnet_track.graph.text.change import ChangeError, change_graph
    from bayesnet_track.graph.text.messages import GraphError
    from bayesnet_track.observation.image_files import AnyMask

    def mistakes(changes: Sequence[str]) -> list[str]:
        try:
            change_graph(text, changes, masks=AnyMask())
        except GraphError as error:
            return [one.found for one in error.errors]
        return []

    try:
        before = mistakes([])
        return next((one for one in mistakes([setting]) if one not in before), None)
    except ChangeError as error:
        return str(error)


@cache
def _types(text: str) -> Mapping[str, Any]:
    import yaml

    types: Mapping[str, Any] = yaml.safe_load(text)["targets"]
    return types


def is_born(run: Run, target: str) -> bool:
    """Whether detections start and end targets of this type."""
    return "birth" in _types(run.graph_text)[run.kinds[target]]


def names_of(text: str, plate: str, agent: str | None = None) -> Mapping[str, str]:
    """What ROOT, MOTION, AGENT and CUE are in a graph."""
    nodes = _types(text)[plate]["nodes"]
    root = next(name for name, node in nodes.items() if "parent" not in node)
    motion = nodes[root].get("motion", MOTION)
    names = {ROOT: root, MOTION: motion if isinstance(motion, str) else next(iter(motion))}
    if agent in nodes:
        cue = nodes[agent]["agent"]
        names |= {AGENT: str(agent), "CUE": cue if isinstance(cue, str) else next(iter(cue))}
    return names
