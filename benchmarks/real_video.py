"""Passes over real sequences, by graphs and by the trackers of an environment with OpenCV's contrib build."""

from __future__ import annotations

import hashlib
import json
import subprocess
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from sequences import Sequence

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import score_pass
from bayesnet_track.graph.settings.net import AGENT_RULES
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.switches import Activated, Deactivated, SelfStopped
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

SWITCHES = (Activated, Deactivated, SelfStopped)
LOOKS = Path(__file__).with_name("real_video_looks.jsonl")
"""The record of every look at a real sequence."""


@dataclass(frozen=True)
class Frames:
    """Overlap, score, status and CPU seconds of each frame but the first."""

    iou: list[float]
    score: list[float]
    status: list[str]
    cpu_s: list[float]


@dataclass(frozen=True)
class Pass:
    """One pass of one tracker over one sequence.

    Attributes:
        auc: OTB success; the last box held counts while it is lost.
        auc_every: the same where every frame's own box counts.
        switches: agents switched on or off per 100 frames.
        agents: agents evaluated per frame, active or sampled.
        in50: share of frames whose true centre lies in the 50 % region; likewise `in90`.
    """

    tracker: str
    graph: str
    sequence: str
    seed: int
    auc: float
    auc_every: float
    switches: float
    agents: float
    in50: float
    in90: float
    frames: Frames


def read_graph(name: str) -> tuple[str, GraphSpec]:
    """A graph by its name or file; `NAME:always` is the same without rules of adaptation."""
    graph, _, how = name.partition(":")
    spec = load_graph(graph).spec
    return f"{Path(graph).stem}{':always' if how else ''}", without_rules(spec) if how else spec


def without_rules(spec: GraphSpec) -> GraphSpec:
    """The graph with every agent in every frame."""
    # Without what nobody wrote: a default may have no effect beside other keys, which is an error.
    written = spec.model_dump(exclude_none=True, exclude_unset=True)
    for plate in written["targets"].values():
        for node in plate["nodes"].values():
            node.pop("adapt", None)
            for rule in AGENT_RULES:
                node.pop(rule, None)
    return GraphSpec.model_validate(written)


def digest(spec: GraphSpec) -> str:
    """A short hash of the graph."""
    written = spec.model_dump(exclude_none=True, exclude={"about"})
    return hashlib.sha256(json.dumps(written, sort_keys=True).encode()).hexdigest()[:12]


def run_graph(name: str, spec: GraphSpec, sequence: Sequence, seed: int) -> Pass:
    """One pass of the engine, frame by frame."""
    tracker = Tracker(spec, seed, copy_frames=False)  # as OpenCV's, which copy none either
    x, y, w, h = (float(value) for value in sequence.truth[0])
    start = (x, y, w, h)
    held, every, frames = [start], [start], Frames([], [], [], [])
    regions: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([(0.0,) * 4], [(0.0,) * 4])
    switched, asked = 0, 0
    for index, image in enumerate(sequence.images()):
        started = time.process_time()
        if index == 0:
            tracker.init(image, start)
            continue
        ok, box = tracker.update(image)
        frames.cpu_s.append(time.process_time() - started)
        # As trackers are usually scored: while lost, the last box that was held counts.
        held.append(box if ok else held[-1])
        every.append(box)
        frames.score.append(tracker.score)
        frames.status.append(tracker.status)
        asked += len(tracker.metrics.kl)
        switched += sum(isinstance(event, SWITCHES) for event in tracker.events)
        regions[0].append(tracker.metrics.region50)
        regions[1].append(tracker.metrics.region90)
    frames.iou.extend(overlaps(every, sequence)[1:])
    lost = [False] * len(held)
    whole = score_pass(held, lost, sequence.truth, region50=regions[0], region90=regions[1])
    count = len(frames.iou)
    return Pass(
        name,
        digest(spec),
        sequence.name,
        seed,
        whole.auc,
        score_pass(every, lost, sequence.truth).auc,
        100.0 * switched / count,
        asked / count,
        float(np.mean(whole.coverage50 or 0.0)),
        float(np.mean(whole.coverage90 or 0.0)),
        frames,
    )


def overlaps(boxes: Iterable[Iterable[float]], sequence: Sequence) -> list[float]:
    """IoU of corner boxes with the true ones, for each frame."""
    truth = centre_from_corner(np.asarray(sequence.truth, dtype=np.float64))
    found = overlap(centre_from_corner(np.array([[*box] for box in boxes], dtype=np.float64)), truth)
    return [float(value) for value in found]


class Elsewhere:
    """OpenCV's trackers by another interpreter (`peers.py`), asked for one pass at a time."""

    def __init__(self, python: str, models: str | None = None) -> None:
        call = [python, str(Path(__file__).with_name("peers.py")), *([models] if models else [])]
        self.process = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        known = self._answer()
        self.opencv, self.trackers = str(known["opencv"]), list(known["trackers"])

    def __enter__(self) -> Elsewhere:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the interpreter of the peers ended")
        return dict(json.loads(line))

    def find(self, name: str, files: Iterable[Path], box: Iterable[float], seed: int = 0) -> dict[str, Any]:
        """The pass of a peer from the box in the first image: `boxes`, `lost`, `scores`, `cpu_s`."""
        assert self.process.stdin is not None
        paths = [str(file.resolve()) for file in files]
        asked = {"tracker": name, "seed": seed, "box": [*box], "files": paths}
        self.process.stdin.write(json.dumps(asked) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def run(self, name: str, sequence: Sequence) -> Pass:
        """One pass of a peer; where it has no score, that is 1, and its status follows from its updates."""
        answer = self.find(name, sequence.files, sequence.truth[0].tolist())
        boxes, lost = answer["boxes"], answer["lost"]
        count = len(boxes) - 1
        status = ["lost" if gone else "tracking" for gone in lost[1:]]
        seconds = [answer["cpu_s"] / max(count, 1)] * count
        frames = Frames(overlaps(boxes, sequence)[1:], answer["scores"][1:], status, seconds)
        auc = score_pass(boxes, lost, sequence.truth).auc
        every = score_pass(boxes, [False] * len(boxes), sequence.truth).auc
        return Pass(name, "", sequence.name, 0, auc, every, 0.0, 0.0, 0.0, 0.0, frames)


def _run(job: tuple[str, GraphSpec, Sequence, int]) -> Pass:
    import cv2

    cv2.setNumThreads(1)
    return run_graph(*job)


def run_all(
    specs: list[tuple[str, GraphSpec]], sequences: list[Sequence], seeds: range, processes: int
) -> Iterator[Pass]:
    """Every pass of every graph: of a sequence and seed one after the other, so that times compare."""
    jobs = [(name, spec, one, seed) for one in sequences for seed in seeds for name, spec in specs]
    if processes == 1:
        yield from map(_run, jobs)
        return
    with get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(_run, jobs, chunksize=len(specs))


def note(file: Path, **what: object) -> None:
    """Add a look to the record: when, at which code, which sequences, for what."""
    call = ["git", "rev-parse", "--short", "HEAD"]
    code = subprocess.run(call, capture_output=True, text=True, check=False).stdout.strip()
    line = {"at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"), "code": code, **what}
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(line) + "\n")
