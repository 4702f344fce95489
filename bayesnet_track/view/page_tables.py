"""Tables of the run page: columns as bytes, frames of a long run, events in words, the graph."""

from __future__ import annotations

import gzip
import json
import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.spec import AgentNode, InferenceNode, Level
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.journal.blocks import Block, Blocks
from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.events.cameras import CameraKnocked, CamerasSwitched, ClockLearnt
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.lives import (
    Continued,
    DuplicateEnded,
    Reacquired,
    Returned,
    TargetDied,
    TargetStarted,
)
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.events.statuses import IdentityDoubtful, SceneCut, StatusChanged
from bayesnet_track.journal.net import Decision, Switch, turns_on
from bayesnet_track.journal.text.sentences import explain, kinds_of, name_targets, split_sentence
from bayesnet_track.journal.text.story import CallsFolded, fold
from bayesnet_track.view.graph_layout import MARGIN, lay_out

KEPT_BITS = 14
ALIGNMENT = 8
TYPES = ("<f4", "<f8", "<i4", "<i2", "|u1")


def pack(header: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Header and columns, compressed with gzip; the same input gives the same bytes.

    Layout before compression: length of the header (uint32), the header as JSON, blanks up to a multiple of
    8 bytes, then the columns, each from a multiple of 8 bytes on. The header gets a key `columns`: name ->
    [type, values per row, number of values, offset behind the header]. All little-endian.

    Args:
        header: what JSON can hold.
        columns: arrays (n,) or (n, k) of float32, float64, int32, int16 or uint8.

    Raises:
        ValueError: an array is of another type or shape.
    """
    index: dict[str, list[Any]] = {}
    blocks: list[bytes] = []
    offset = 0
    for name, column in columns.items():
        kind = column.dtype.newbyteorder("<").str
        if kind not in TYPES or column.ndim not in (1, 2):
            raise ValueError(f"column {name!r} is {column.dtype} {column.shape}; one of {', '.join(TYPES)}")
        data = np.ascontiguousarray(column, dtype=kind).tobytes()
        width = column.shape[1] if column.ndim == 2 else 1
        index[name] = [kind[1:], width, column.size, offset]
        blocks.append(data + bytes(-len(data) % ALIGNMENT))
        offset += len(blocks[-1])
    text = json.dumps({**header, "columns": index}, allow_nan=False, separators=(",", ":")).encode()
    head = struct.pack("<I", len(text)) + text
    head += b" " * (-len(head) % ALIGNMENT)
    return gzip.compress(head + b"".join(blocks), compresslevel=6, mtime=0)


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and columns of `pack`."""
    raw = gzip.decompress(data)
    (length,) = struct.unpack("<I", raw[:4])
    header = json.loads(raw[4 : 4 + length])
    start = 4 + length + (-(4 + length) % ALIGNMENT)
    columns = {}
    for name, (kind, width, count, offset) in header.pop("columns").items():
        flat = np.frombuffer(raw, dtype=f"<{kind}", count=count, offset=start + offset)
        columns[name] = flat.reshape(-1, width) if width > 1 else flat
    return header, columns


def short_floats(values: Any) -> NDArray[np.float32]:
    """Float32 with 14 bits of mantissa, rounded: relative error below 2^-15, and half as long when packed.

    >>> float(short_floats([1234.56])[0])
    1234.5625
    """
    with np.errstate(over="ignore"):
        exact = np.asarray(values, dtype=np.float32)
    drop = 23 - KEPT_BITS
    with np.errstate(over="ignore"):
        bits = (exact.view(np.uint32) + np.uint32(1 << (drop - 1))) & np.uint32(
            0xFFFFFFFF << drop & 0xFFFFFFFF
        )
    rounded = bits.view(np.float32)
    return np.where(np.isfinite(exact) & np.isfinite(rounded), rounded, exact)


LIVES = (TargetStarted, Returned, Reacquired, Continued, TargetDied, DuplicateEnded, Joined, Parted)


def event_rows(events: Iterable[Event]) -> list[dict[str, Any]]:
    """`event_row` of every event that happened in a frame, in order."""
    event_list = list(events)
    kinds = kinds_of(event_list)
    return [
        _calls_row(event, kinds) if isinstance(event, CallsFolded) else event_row(event, kinds)
        for event in fold(event_list)
        if not isinstance(event, RunStarted | RunEnded)
    ]


def _calls_row(calls: CallsFolded, kinds: Mapping[str, str]) -> dict[str, Any]:
    """Runs of agents on call as one row."""
    sentence = name_targets(calls.describe(), kinds)
    return {
        "frame": calls.frame,
        "kind": "scheduled",
        "sort": "note",
        "what": sentence,
        "why": "",
        "unless": "",
        "target": calls.target,
    }


def event_row(event: Event, kinds: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """One event of a frame as plain data; `kinds` names targets by their type.

    Keys: `frame`; `target`, `other` and `node` where it has them; `kind`, its name in the journal; `sort`:
    switch (an agent on or off), life (of a target, or of a pair), status, camera, or note (everything else);
    `camera`: of which camera; `state`:
    whether a switch turned the agent on; `status`: the new one; `change` happened, `why`, and what would have
    prevented it (`unless`), the pieces of its sentence, of which the last two may be empty; `doubt` of an
    identity: frame since when, probability, and whether two would be swapped.
    """
    _, why, change, prevented = split_sentence(name_targets(explain(event), kinds))
    row: dict[str, Any] = {
        "frame": getattr(event, "frame", 0),
        "kind": event_name(type(event)),
        "sort": _sort(event),
        "what": change,
        "why": why,
        "unless": prevented,
    }
    if isinstance(event, TargetStarted):
        # Nothing caused it: the piece before the arrow is what happened.
        row |= {"what": f"{why} → {change}", "why": ""}
    if isinstance(event, Toggled):
        state = "on" if event.on else "off"
        row |= {
            "what": f"{event.node} {state} by hand",
            "why": "switched by hand; no rule switches it until it is released",
        }
    if isinstance(event, Released):
        row |= {"what": f"{event.node} given back to the rules", "why": ""}
    row |= {key: getattr(event, key) for key in ("target", "other", "node", "camera") if hasattr(event, key)}
    if isinstance(event, Switch):
        row["on"] = turns_on(event)
    if isinstance(event, StatusChanged):
        row["status"] = event.status
    if isinstance(event, SceneCut):
        row["status"] = "lost"
    if isinstance(event, IdentityDoubtful):
        row["doubt"] = {"since": event.since, "probability": event.probability, "mutual": event.mutual}
    return row


def _sort(event: Event) -> str:
    if isinstance(event, Switch):
        return "switch"
    if isinstance(event, (*LIVES, Released)):
        return "life"
    if isinstance(event, StatusChanged | SceneCut):
        return "status"
    return "camera" if isinstance(event, CameraKnocked | CamerasSwitched | ClockLearnt) else "note"


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
        "ud_unit": "m²" if target.spec.is_ground else "px²",
        "views": [*target.views],
        "area": []
        if isinstance(state := target.spec.state, str) or state.ground is None
        else [list(corner) for corner in state.ground.area or ()],
        "net": _net(target),
        "hidden_modes": [name for name, mode in (root.modes or {}).items() if mode.hidden is not None],
        "settings": {name: settings_text(target, name) for name in target.spec.nodes},
    }


def settings_text(target: CheckedTarget, name: str) -> str:
    """Settings of a node, as YAML: what the graph says of it, and all parameters of a cue."""
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
    rules: list[dict[str, Any]] = []

    def add(node: str, rule: str, level: Level | None, frames: int = 1) -> None:
        if level is not None:
            rules.append(
                {"node": node, "rule": rule, "unit": level.kind, "level": level.settings, "frames": frames}
            )

    for name, node in target.spec.nodes.items():
        if isinstance(node, AgentNode):
            for key, rule in node.rules.items():
                add(name, key, rule.level if isinstance(rule.level, Level) else None, rule.frames)
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
            lost = target.lost if name == target.root else None
            if lost is not None and lost.score_below is None and lost.existence_rule is None:
                add(name, "lost", lost.above, lost.frames)
            for key in ("score_below", "uncertain_below"):
                level = None if lost is None else getattr(lost, key)
                if level is not None:
                    rules.append({"node": name, "rule": key, "unit": "score", "level": level, "frames": 1})
    return rules


MOST_ROWS = 200_000
"""Rows (a target in a frame) that a page shows, about; of a run with more it shows some."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Rows of a page.

    Attributes:
        rows: those that are shown, in order.
        about: None where they are all. Else `step`, the frames for which a row stands; `rows`, how many they
            are, and `of` how many; `frames`, in which there is a row; one in `decisions` of the rows with a
            decision is shown.
        counts: target -> frames, lost ones, uncertain ones, and frames of each active agent, over all rows.
    """

    rows: Block
    about: Mapping[str, int] | None
    counts: Mapping[str, Mapping[str, Any]]

    def counted(self, target: str) -> dict[str, Any]:
        """The key `counted` of a target's header, where not all of its rows are shown."""
        return {} if self.about is None else {"counted": self.counts[target]}


def choose_rows(blocks: Blocks, events: Sequence[Event]) -> Shown:
    """The rows to show: all, or at most about `MOST_ROWS`.

    Of a long run they are every n-th frame, the frame with the largest UD of each target between two of them,
    and those with a decision about the target: no peak and no switch is missing from a curve.
    """
    if blocks.rows <= MOST_ROWS:
        return Shown(blocks.joined([*blocks]), None, {})
    step = -(-2 * blocks.rows // MOST_ROWS)
    frames = blocks.frames()
    decided = dict.fromkeys((event.target, event.frame) for event in events if isinstance(event, Decision))
    nth = max(1, -(-4 * len(decided) // MOST_ROWS))
    selected: list[Block] = []
    counts: Counter[tuple[int, int, int]] = Counter()
    for block in blocks:
        keys = [block.codes(name).astype(np.int64) for name in ("target", "status", "active")]
        combined = keys[0] << 40 | keys[1] << 32 | keys[2]
        for key, count in zip(
            *(column.tolist() for column in np.unique(combined, return_counts=True)), strict=True
        ):
            counts[key >> 40, (key >> 32) & 0xFF, key & 0xFFFF_FFFF] += count
        index = np.searchsorted(frames, block.frame)
        is_kept = (index % step == 0) | (index == len(frames) - 1) | _peaks(block, index // step)
        is_kept |= np.isin(_place(keys[0], block.frame), _places([*decided][::nth], blocks))
        selected.append(block.of_rows(np.flatnonzero(is_kept)))
    rows = blocks.joined(selected)
    interval = int(np.median(np.diff(frames[::step]))) if len(frames) > step else step
    summary = {
        "step": interval,
        "rows": len(rows),
        "of": blocks.rows,
        "frames": len(frames),
        "decisions": nth,
    }
    return Shown(rows, summary, _by_target(counts, blocks))


def _places(decided: Sequence[tuple[str, int]], blocks: Blocks) -> NDArray[np.int64]:
    numbers = {target: number for number, target in enumerate(blocks.texts["target"].texts)}
    pairs = [(numbers[target], frame) for target, frame in decided if target in numbers]
    targets, frames = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return _place(targets, frames)


def _place(targets: NDArray[np.int64], frames: NDArray[np.int64]) -> NDArray[np.int64]:
    return targets << 32 | frames


def _peaks(block: Block, stretch: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether a row has the largest UD of its target in its stretch of frames."""
    uds = np.nan_to_num(block.numbers("ud_px2"), nan=-np.inf, posinf=np.inf)
    order = np.lexsort((-uds, stretch, block.codes("target")))
    groups = np.stack([block.codes("target")[order], stretch[order]])
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (groups[:, 1:] != groups[:, :-1]).any(axis=0)
    is_peak = np.zeros(len(order), dtype=bool)
    is_peak[order[is_first]] = True
    return is_peak


def _by_target(counts: Mapping[tuple[int, int, int], int], blocks: Blocks) -> dict[str, dict[str, Any]]:
    names, statuses, groups = (blocks.texts[name].texts for name in ("target", "status", "active"))
    counted: dict[str, dict[str, Any]] = {
        name: {"frames": 0, "lost": 0, "uncertain": 0, "active": {}} for name in names
    }
    for (target, status, group), count in counts.items():
        of_target = counted[names[target]]
        of_target["frames"] += count
        if statuses[status] in ("lost", "uncertain"):
            of_target[statuses[status]] += count
        for agent in groups[group].split():
            of_target["active"][agent] = of_target["active"].get(agent, 0) + count
    return counted
