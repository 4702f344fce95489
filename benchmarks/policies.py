"""Policies of adaptation side by side: the thesis' rule, its baseline, and those that go by evidence.

    python benchmarks/policies.py [DATA_FOLDER] [--graph general] [--seeds 1] [--max-frames 200]
                                  [--sequences Car1,Crossing] [--policies "always on;UD, information per ms"]

Each policy is the given graph with its `adapt` (and `learn`) rules exchanged, so that nothing else differs.
DATA_FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt, as in benchmarks/sequences.py; without one only the
scene `two_squares` is run, with the graph of that name. Agents are counted per frame; milliseconds are the
tracker's CPU time; a reconfiguration is one agent switched on or off.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Image, environment, on_one_thread, table
from numpy.typing import NDArray
from sequences import find_sequences

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import score
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.self_checks import SelfStopped
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.sources.scenes import two_squares

Rules = dict[str, Any]
SWITCHES = (Activated, Deactivated, SelfStopped)
Corner = tuple[float, float, float, float]

TEST = {"concentrated": {"share": 0.9, "within_box": 0.5, "confidence": 0.95}}


@dataclass(frozen=True, eq=False)
class Task:
    """Pictures of one target: how to read them, and its true corner boxes (n, 4)."""

    name: str
    images: Callable[[], Iterable[Image]]
    truth: NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """What one run of one policy gave."""

    auc: float
    agents: float
    milliseconds: float
    switches: float


def as_it_is(rules: Rules) -> Rules | None:
    """The graph's own rules, glances included."""
    return rules


def always_on(rules: Rules) -> Rules | None:
    """No rules: every agent that starts works to the end."""
    return None


def thesis(rules: Rules) -> Rules:
    """The graph's own levels of UD; all on, largest KL off."""
    on, off = (
        rules["activate"],
        {key: rules["deactivate"][key] for key in rules["deactivate"] if key != "sample_every"},
    )
    return {**rules, "activate": {**on, "which": "all"}, "deactivate": {**off, "drop": "largest_kl"}}


def quiet_level(rules: Rules) -> Rules:
    """Levels as multiples of the UD that the smallest set of agents showed while all was well."""
    on, off = _without(rules["activate"], "above"), _without(rules["deactivate"], "below")
    return thesis(
        {
            **rules,
            "activate": {"above": {"ud_baseline": 2.0}, **on},
            "deactivate": {"below": {"ud_baseline": 1.3}, **off},
        }
    )


def concentration(rules: Rules) -> Rules:
    """A binomial test instead of levels, with the graph's delays."""
    on, off = _without(rules["activate"], "above"), _without(rules["deactivate"], "below")
    return thesis({**rules, "activate": {"unless": TEST, **on}, "deactivate": {"when": TEST, **off}})


def information(rules: Rules) -> Rules:
    """The graph's levels; on whom most is expected of per millisecond, off who gave least."""
    return {
        **rules,
        "activate": {**rules["activate"], "which": "information_per_ms"},
        "deactivate": {**thesis(rules)["deactivate"], "drop": "min_information_per_ms"},
    }


def evidence(rules: Rules) -> Rules:
    """Both: the test says when, information per millisecond says who."""
    return information(concentration(rules))


POLICIES: Mapping[str, tuple[Callable[[Rules], Rules | None], bool]] = {
    "the graph's own": (as_it_is, False),
    "always on": (always_on, False),
    "UD, all / largest KL (thesis)": (thesis, False),
    "baseline, all / largest KL": (quiet_level, False),
    "concentration test, all / largest KL": (concentration, False),
    "UD, information per ms": (information, False),
    "concentration test, information per ms": (evidence, False),
    "always on, guarded": (always_on, True),
    "UD, all / largest KL, guarded": (thesis, True),
    "concentration test, information per ms, guarded": (evidence, True),
}
"""Name -> how it changes the rules, and whether references are guarded against drift."""


def _without(rules: Rules, *names: str) -> Rules:
    return {
        key: value for key, value in rules.items() if key not in (*names, "above", "below", "unless", "when")
    }


def variant(base: str, policy: str) -> GraphSpec:
    """The graph with the rules of a policy; nodes without rules keep having none."""
    change, guarded = POLICIES[policy]
    written = load_graph(base).spec.model_dump(exclude_none=True)
    for plate in written["targets"].values():
        for node in plate["nodes"].values():
            if "adapt" in node:
                changed = change(node.pop("adapt"))
                node |= {} if changed is None else {"adapt": changed}
            if "learn" in node:
                node["learn"].pop("guard", None)
                node["learn"] |= {"guard": {}} if guarded else {}
    return GraphSpec.model_validate(written)


def run(graph: GraphSpec, task: Task, seed: int) -> Outcome:
    """One pass from the first true box."""
    tracker = Tracker(graph, seed)
    boxes: list[Corner] = []
    active: list[int] = []
    switched = 0
    seconds: list[float] = []
    for image in task.images():
        started = time.process_time()
        if not boxes:
            x, y, w, h = (float(value) for value in task.truth[0])
            tracker.init(image, (x, y, w, h))
            boxes.append((x, y, w, h))
        else:
            boxes.append(tracker.update(image)[1])
            seconds.append(time.process_time() - started)
            active.append(len(tracker.metrics.active))
            switched += sum(isinstance(event, SWITCHES) for event in tracker.events)
    auc = score(boxes, [False] * len(boxes), task.truth).auc
    return Outcome(
        float("nan") if auc is None else auc,
        float(np.mean(active)),
        float(np.median(seconds)) * 1e3,
        100.0 * switched / len(active),
    )


def tasks_of(folder: Path, names: list[str], most: int | None) -> Iterator[Task]:
    """The sequences of a folder."""
    for sequence in find_sequences(folder, names, most):
        yield Task(sequence.name, sequence.images, sequence.truth)


def main() -> None:
    """Print a table per task as it is done, then the means."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--graph", default="general")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--sequences", default="", help="comma-separated names; default all")
    parser.add_argument("--policies", default="", help="names, separated by semicolons; default all")
    parser.add_argument("--max-frames", type=int)
    parser.add_argument("--no-scene", action="store_true", help="without the scene two_squares")
    options = parser.parse_args()
    on_one_thread()
    policies = [name for name in options.policies.split(";") if name] or list(POLICIES)
    unknown = [name for name in policies if name not in POLICIES]
    if unknown:
        raise SystemExit(f"no policy {unknown[0]!r}; there are {', '.join(POLICIES)}")
    wanted = [name for name in options.sequences.split(",") if name]

    print(environment() + "\n")
    if not options.no_scene:
        scene = two_squares(0)
        report("two_squares", [Task(scene.name, lambda: scene.frames, scene.truth)], policies, options.seeds)
    if options.data is not None:
        report(
            options.graph, list(tasks_of(options.data, wanted, options.max_frames)), policies, options.seeds
        )


def report(graph: str, tasks: list[Task], policies: list[str], seeds: int) -> None:
    """Run every policy on every task, and print the means."""
    print(f"graph {graph}, {seeds} seed{'' if seeds == 1 else 's'}\n")
    head = ["policy", "AUC", "agents", "ms / frame", "switches / 100 frames", *(f"{t.name}" for t in tasks)]
    rows = []
    for policy in policies:
        spec = variant(graph, policy)
        outcomes = [[run(spec, task, seed) for seed in range(seeds)] for task in tasks]
        flat = [one for several in outcomes for one in several]
        means = [
            float(np.mean([getattr(o, k) for o in flat]))
            for k in ("auc", "agents", "milliseconds", "switches")
        ]
        each = [f"{np.mean([one.auc for one in several]):.3f}" for several in outcomes]
        rows.append(
            [policy, f"{means[0]:.3f}", f"{means[1]:.2f}", f"{means[2]:.2f}", f"{means[3]:.1f}", *each]
        )
        print("| " + " | ".join(rows[-1]) + " |", flush=True)
    print("\n" + table(head, rows) + "\n")


if __name__ == "__main__":
    main()
