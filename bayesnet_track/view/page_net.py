"""The graph of a run as the run page draws it: nodes with places, and the levels of its rules."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.spec import AgentNode, InferenceNode, Level, Lost
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.view.graph_layout import MARGIN, lay_out


def plates(graph: CheckedGraph, costs_ms: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Plate -> its root, agents, rules and picture, as plain data."""
    return {name: _plate(target, costs_ms) for name, target in graph.targets.items()}


def _plate(target: CheckedTarget, costs_ms: Mapping[str, float]) -> dict[str, Any]:
    agents, root = [], target.inference(target.root)
    for name in target.agents:
        cue = target.agent(name).agent.cue
        agents.append({"name": name, "cue": cue, "cost_ms": costs_ms.get(cue)})
    return {
        "root": target.root,
        "agents": agents,
        "rules": _rules(target),
        "net": _net(target),
        "hidden_modes": [name for name, mode in (root.modes or {}).items() if mode.hidden is not None],
        "settings": {name: settings_text(target, name) for name in target.spec.nodes},
    }


def settings_text(target: CheckedTarget, name: str) -> str:
    """What holds of a node, as YAML: what the graph says of it, and all parameters of a cue."""
    plain = {key: value for key, value in as_plain(target.spec.nodes[name]).items() if key != "parent"}
    parameters = target.parameters.get(name)
    if parameters is not None:
        plain["agent"] = {target.agent(name).agent.cue: parameters.model_dump(mode="json")}
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=60).strip()


def _net(target: CheckedTarget) -> dict[str, Any]:
    """Places in the units of `graph_layout`, without its margins and legend."""
    layout = lay_out(target, frozenset(target.agents))
    left = min(node.x - node.w / 2 for node in layout.nodes) - 4.0
    right = max(node.x + node.w / 2 for node in layout.nodes) + 4.0
    top = MARGIN - 4.0
    nodes = [
        {
            "name": node.name,
            "note": node.note,
            "agent": node.is_agent,
            "x": node.x - left,
            "y": node.y - top,
            "w": node.w,
            "h": node.h,
            "parent": target.parent[node.name],
        }
        for node in layout.nodes
    ]
    edges = [
        {
            "child": child,
            "from": [edge.start[0] - left, edge.start[1] - top],
            "to": [edge.end[0] - left, edge.end[1] - top],
        }
        for child, edge in zip((n for n in target.order if target.parent[n]), layout.edges, strict=True)
    ]
    forks = [{"text": f.text, "x": f.x - left, "y": f.y - top, "w": f.w, "h": f.h} for f in layout.forks]
    height = max(node.y + node.h / 2 for node in layout.nodes) - top + 4.0
    return {"width": right - left, "height": height, "nodes": nodes, "edges": edges, "forks": forks}


def _rules(target: CheckedTarget) -> list[dict[str, Any]]:
    """Every level of UD or of the score in the plate: node, rule, unit, level, frames."""
    found: list[dict[str, Any]] = []

    def add(node: str, rule: str, level: Level | None, frames: int = 1) -> None:
        if level is not None:
            found.append(
                {"node": node, "rule": rule, "unit": level.kind, "level": level.settings, "frames": frames}
            )

    for name, node in target.spec.nodes.items():
        if isinstance(node, AgentNode):
            if node.self_check is not None:
                add(name, "self_check", node.self_check.above, node.self_check.frames)
        elif isinstance(node, InferenceNode):
            adapt = node.adapt
            if adapt is not None and adapt.activate is not None:
                add(name, "activate", adapt.activate.above, adapt.activate.frames)
            if adapt is not None and adapt.deactivate is not None:
                add(name, "deactivate", adapt.deactivate.below, adapt.deactivate.frames)
            if adapt is not None and adapt.on_call is not None:
                add(name, "on_call", adapt.on_call.above)
            if node.learn is not None:
                add(name, "learn", node.learn.below)
            lost = (node.lost or Lost()) if name == target.root else None
            if lost is not None and lost.score_below is None and lost.existence_below is None:
                add(name, "lost", lost.above, lost.frames)
            for rule in ("score_below", "uncertain_below"):
                level = None if lost is None else getattr(lost, rule)
                if level is not None:
                    found.append({"node": name, "rule": rule, "unit": "score", "level": level, "frames": 1})
    return found
