"""A graph on real sequences beside its own variants and OpenCV's trackers, all in turn in one run.

    python benchmarks/real_video.py DATA_FOLDER [--seeds 10] [--results FILE] [--peers-python PYTHON]
                                    [--beside FILE]

DATA_FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt with x,y,w,h per frame (the layout of the OTB
benchmark). One pass from the first true box, never started again. Variants: the graph as it is; `always on`,
without its rules of adaptation; `only NAME`, with one agent; and the graph of `--beside`, such as one without
rules whose score `fit` has fitted to itself. PYTHON is the interpreter of an environment that
has `opencv-contrib-python-headless`; without it only MIL can take part. CSRT and KCF do not depend on a seed
and run once.

Each pass adds a line to FILE, and one that it holds is not run again: a long run can be stopped and taken
up again. Lines of other graphs are left alone. Times are CPU seconds of the tracker's work, without decoding.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from measuring import environment, on_one_thread
from real_video_tables import Line, differences_table, means_table, names_of, sequences_table
from sequences import Sequence, find_sequences

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import score
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.self_checks import SelfStopped
from bayesnet_track.journal.events.switches import Activated, Deactivated

SEEDLESS = ("CSRT", "KCF")
SWITCHES = (Activated, Deactivated, SelfStopped)


def variants(graph: str) -> dict[str, GraphSpec]:
    """Name -> graph: as it is, always on, and each agent alone."""
    spec = load_graph(graph).spec
    found = {spec.name: spec}
    if _with_rules(spec):
        found["always on"] = changed(spec, without_rules=True)
    agents = agents_of(spec)
    if len(agents) > 1:
        found |= {f"only {name}": changed(spec, without_rules=True, only=name) for name in agents}
    return found


def _nodes(written: dict[str, Any]) -> dict[str, dict[str, Any]]:
    (plate,) = written["targets"].values()
    nodes: dict[str, dict[str, Any]] = plate["nodes"]
    return nodes


def _with_rules(spec: GraphSpec) -> bool:
    nodes = _nodes(spec.model_dump(exclude_none=True)).values()
    return any("adapt" in node or "self_check" in node for node in nodes)


def agents_of(spec: GraphSpec) -> list[str]:
    """Names of the agent nodes of a graph with one kind of target."""
    return [name for name, node in _nodes(spec.model_dump(exclude_none=True)).items() if "agent" in node]


def changed(spec: GraphSpec, *, without_rules: bool = False, only: str | None = None) -> GraphSpec:
    """The graph without rules of adaptation, or with one agent; nodes that are left without children go."""
    # Without what nobody wrote: a default may have no effect beside other keys, which is an error.
    written = spec.model_dump(exclude_none=True, exclude_unset=True)
    nodes = _nodes(written)
    for name in [
        name for name, node in nodes.items() if only is not None and "agent" in node and name != only
    ]:
        del nodes[name]
    while empty := [
        name
        for name, node in nodes.items()
        if "agent" not in node and all(other.get("parent") != name for other in nodes.values())
    ]:
        for name in empty:
            del nodes[name]
    for node in nodes.values():
        if without_rules:
            node.pop("adapt", None)
            node.pop("self_check", None)
    return GraphSpec.model_validate(written)


def digest(spec: GraphSpec) -> str:
    """What a graph's lines are known by."""
    written = spec.model_dump(exclude_none=True, exclude={"about"})
    return hashlib.sha256(json.dumps(written, sort_keys=True).encode()).hexdigest()[:12]


def run_graph(name: str, spec: GraphSpec, sequence: Sequence, seed: int) -> Line:
    """One pass of the engine."""
    tracker = Tracker(spec, seed)
    x, y, w, h = (float(value) for value in sequence.truth[0])
    boxes, lost, active, seconds, switched = [(x, y, w, h)], [False], [], [], 0
    every = boxes[:]
    region50, region90 = [], []
    for index, image in enumerate(sequence.images()):
        started = time.process_time()
        if index == 0:
            tracker.init(image, (x, y, w, h))
        else:
            ok, box = tracker.update(image)
            seconds.append(time.process_time() - started)
            # As trackers are usually scored: while lost, the last box that was held counts.
            boxes.append(box if ok else boxes[-1])
            every.append(box)
            lost.append(not ok)
            active.append(len(tracker.metrics.active))
            switched += sum(isinstance(event, SWITCHES) for event in tracker.events)
        region50.append(tracker.metrics.region50)
        region90.append(tracker.metrics.region90)
    found = score(boxes, lost, sequence.truth, region50=region50, region90=region90)
    return Line(
        tracker=name,
        graph=digest(spec),
        sequence=sequence.name,
        frames=len(boxes),
        seed=seed,
        auc=found.auc,
        precision20=found.precision20,
        lost_episodes=found.lost_episodes,
        cpu_s=sum(seconds),
        agents=float(np.mean(active)),
        switches=100.0 * switched / len(active),
        in50=float(np.mean(found.coverage50 or 0.0)),
        in90=float(np.mean(found.coverage90 or 0.0)),
        auc_every=score(every, [False] * len(every), sequence.truth).auc,
    )


class Elsewhere:
    """OpenCV's trackers by another interpreter, asked for one pass at a time."""

    def __init__(self, python: str, arguments: list[str] | None = None) -> None:
        script = str(Path(__file__).with_name("real_video_peers.py"))
        self.process = subprocess.Popen(
            [python, script, *(arguments or [])], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        found = self._answer()
        self.opencv, self.trackers = str(found["opencv"]), list(found["trackers"])

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
        """What a peer finds from the box in the first picture: `boxes`, `lost`, `scores`, `cpu_s`."""
        assert self.process.stdin is not None
        asked = {
            "tracker": name,
            "seed": seed,
            "box": [*box],
            "files": [str(file.resolve()) for file in files],
        }
        self.process.stdin.write(json.dumps(asked) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def run(self, name: str, sequence: Sequence, seed: int) -> Line:
        """One pass of a peer."""
        return self.run_with_boxes(name, sequence, seed)[0]

    def run_with_boxes(
        self, name: str, sequence: Sequence, seed: int
    ) -> tuple[Line, list[tuple[float, ...]], list[bool]]:
        """One pass of a peer, its corner boxes, and where it said that it had lost the target."""
        answer = self.find(name, sequence.files, sequence.truth[0].tolist(), seed)
        found = score(answer["boxes"], answer["lost"], sequence.truth)
        every = score(answer["boxes"], [False] * len(answer["boxes"]), sequence.truth)
        line = Line(
            name,
            "",
            sequence.name,
            len(sequence.files),
            seed,
            found.auc,
            found.precision20,
            found.lost_episodes,
            answer["cpu_s"],
            auc_every=every.auc,
        )
        return line, [tuple(box) for box in answer["boxes"]], answer["lost"]


def passes(
    specs: dict[str, GraphSpec],
    peers: list[str],
    elsewhere: Elsewhere | None,
    sequences: list[Sequence],
    seeds: range,
    done: list[Line],
) -> Iterator[Line]:
    """Every pass that is not done: of a sequence and seed one after the other, so that times compare."""
    known = {(line.tracker, line.graph, line.sequence, line.frames, line.seed) for line in done}
    for seed in seeds:
        for sequence in sequences:
            for name, spec in specs.items():
                if (name, digest(spec), sequence.name, len(sequence.files), seed) not in known:
                    yield run_graph(name, spec, sequence, seed)
            for name in peers if elsewhere is not None else []:
                number = 0 if name in SEEDLESS else seed
                key = (name, "", sequence.name, len(sequence.files), number)
                if key not in known:
                    known.add(key)
                    yield elsewhere.run(name, sequence, number)


def report(lines: list[Line]) -> str:
    """All tables."""
    text = "means over sequences\n\n" + means_table(lines) + "\n\n" + sequences_table(lines)
    return text + ("\n\n" + differences_table(lines) if len(names_of(lines, "tracker")) > 1 else "")


def read_lines(file: Path | None) -> list[Line]:
    """The lines of a results file, if there is one."""
    if file is None or not file.exists():
        return []
    return [
        Line(**json.loads(text)) for text in file.read_text(encoding="utf-8").splitlines() if text.strip()
    ]


def main() -> None:
    """Run what is missing, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general", help="name or file (general)")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds (3)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--variants", default="", help="names, separated by commas; default all")
    parser.add_argument("--beside", metavar="FILE", help="another graph that takes its turn")
    parser.add_argument("--peers", default="CSRT,KCF,MIL", help="names, separated by commas; empty for none")
    parser.add_argument(
        "--peers-python", metavar="PYTHON", help="interpreter that has OpenCV's contrib build"
    )
    parser.add_argument("--sequences", default="", help="names, separated by commas; default all")
    parser.add_argument("--max-frames", type=int)
    parser.add_argument(
        "--results", type=Path, metavar="FILE", help="JSON Lines: what is there is not run again"
    )
    options = parser.parse_args()
    on_one_thread()
    wanted = [name for name in options.sequences.split(",") if name]
    sequences = find_sequences(options.data, wanted, options.max_frames)
    if not sequences:
        raise SystemExit(f"{options.data}: no NAME/img/*.jpg with NAME/groundtruth.txt")
    specs = variants(options.graph)
    chosen = [name for name in options.variants.split(",") if name] or list(specs)
    if unknown := [name for name in chosen if name not in specs]:
        raise SystemExit(f"no variant {unknown[0]!r}; there are {', '.join(specs)}")
    specs = {name: specs[name] for name in chosen}
    if options.beside is not None:
        beside = load_graph(options.beside).spec
        specs[beside.name] = beside
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    lines = read_lines(options.results)

    print(environment(), flush=True)
    with Elsewhere(options.peers_python or sys.executable) as elsewhere:
        peers = [name for name in options.peers.split(",") if name in elsewhere.trackers]
        print(f"peers by OpenCV {elsewhere.opencv}: {', '.join(peers) or 'none'}\n")
        for line in passes(specs, peers, elsewhere, sequences, seeds, lines):
            lines.append(line)
            if options.results is not None:
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(line)) + "\n")
    valid = {*((name, digest(spec)) for name, spec in specs.items()), *((name, "") for name in peers)}
    frames = {sequence.name: len(sequence.files) for sequence in sequences}
    shown = [line for line in lines if (line.tracker, line.graph) in valid]
    shown = [line for line in shown if frames.get(line.sequence) == line.frames]
    order = [*specs, *peers]
    print(report(sorted(shown, key=lambda line: (order.index(line.tracker), line.sequence, line.seed))))


if __name__ == "__main__":
    main()
