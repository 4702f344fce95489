"""Worth of policies for agents on call, beside none, chance, and one that knows the ground truth.

    python benchmarks/regret.py DATA_FOLDER --graph deep --agents network --why WORDS
        [--rule EVERY,AGREE,UD_BOX] [--reserve '{texture: {parent: target, agent: texture}}']
        [--strata "chosen on,untuned"] [--first-seed 0] [--seeds 1] [--max-frames 150] [--passes FILE]

Agents on call look after the others, in the same frame, when the policy says so (`adapt: on_call`). The
graph's own rule runs as it is; `ud` and `disagreement` are its two halves. With `--reserve` there is no own
rule, and `ud` calls above its level alone. Of the others the decision is replaced: `random` and `periodic`
take the share of the frames that the rule took in the same run, `score` calls where the last score was low,
and `oracle` where the IoU of what the others found is low. Levels of these two are quantiles of all frames
before, so that each takes about as many looks as the rule. The intervals are of a bootstrap over sequences.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml
from measuring import environment, on_one_thread, table
from real_video import LOOKS, Pass, digest, note, read_graph, run_graph
from real_video_whole import HEAD, describe_difference, means_of, row_of
from sequences import STRATA, find_sequences

from bayesnet_track.belief.contract import estimate
from bayesnet_track.engine import filtering, second_steps
from bayesnet_track.engine.second_steps import overlap_of_two
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.runtime.tracker import Tracker

NEVER, ALWAYS = "never", "always"
POLICIES = "rule,ud,disagreement,always,never,random,periodic,score,oracle"
HUGE = 1e9
NOTHING = {"every": 1000, "agree": 0.01, "above": {"ud_box": HUGE}}
"""A rule that asks for nothing, where the decision is replaced; references learn where the agents looked."""
LEARNS = {"every": 2, "agree": 0.9999, "above": {"ud_box": HUGE}}
"""The same for a reserve: references learn in every frame, whether it looked or not."""


def with_agents_on_call(
    spec: GraphSpec, agents: tuple[str, ...], rule: dict[str, Any], reserve: dict[str, Any]
) -> GraphSpec:
    """The graph, whose first plate has `reserve` as further agents, and `agents` on call by `rule`."""
    written = spec.model_dump(exclude_none=True, exclude_unset=True)
    nodes = next(iter(written["targets"].values()))["nodes"]
    nodes |= reserve
    root = next(iter(nodes.values()))
    root["learn"].pop("every", None)
    root["adapt"] = {"agents": [*agents], "on_call": rule}
    return GraphSpec.model_validate(written)


@dataclass
class Decision:
    """When agents on call look, in place of the graph's rule.

    Attributes:
        name: the policy.
        share: of the frames, that it shall take.
        rng: of `random`.
        truth: (n, 4) true corner boxes of the sequence.
        score: after the last frame.
        levels: values in the frames so far, of all sequences.
    """

    name: str
    share: float
    rng: np.random.Generator
    truth: Any = None
    score: float = 1.0
    levels: list[float] = field(default_factory=list)

    def looks(self, frame: int, box: Any) -> bool:
        """True if they look in the frame, in which the others found the centre box (4,)."""
        if self.name in (NEVER, ALWAYS, "ud"):  # above a level of UD they look in any case
            return self.name == ALWAYS
        if self.name == "random":
            return bool(self.rng.random() < self.share)
        if self.name == "periodic":
            return int(frame * self.share) > int((frame - 1) * self.share)
        value = self.score
        if self.name == "oracle":
            value = overlap_of_two(np.array(box[:4]), centre_from_corner(self.truth[frame][None])[0])
        self.levels.append(value)
        return value <= float(np.quantile(self.levels[-5000:], self.share))


@contextmanager
def replaced(decision: Decision) -> Iterator[None]:
    """The engine with another decision when agents on call look."""
    update, call = Tracker.update, second_steps.call_agents

    def follow(tracker: Tracker, *image: Any) -> Any:
        answer = update(tracker, *image)
        decision.score = tracker.score
        return answer

    def decide(work: Any, target: str, before: Any, observer: Any, steps: Any) -> Any:
        root = work.plate_of(target).plate
        box = estimate(root.inference(root.root).estimate, steps[1])
        looks = work.frame.index < len(decision.truth) and decision.looks(work.frame.index, box)
        with patch.object(second_steps, "is_due", lambda *_: looks):
            return call(work, target, before, observer, steps)

    with ExitStack() as stack:
        stack.enter_context(patch.object(filtering, "call_agents", decide))
        stack.enter_context(patch.object(Tracker, "update", follow))
        yield


def run_policies(
    spec: GraphSpec, agents: tuple[str, ...], rule: dict[str, Any], reserve: dict[str, Any], options: Any
) -> Iterator[tuple[Pass, float]]:
    """Every policy over every sequence and seed, with the share of the frames in which the agents looked."""
    ud = {"above": rule["above"]}
    kept = {
        "rule": rule,
        "ud": {**NOTHING, **ud},
        "disagreement": {**rule, "above": {"ud_box": HUGE}},
    }
    sequences = find_sequences(options.data, options.names, options.max_frames)
    took: list[float] = []
    for name in options.policies.split(","):
        share = float(np.mean(took)) if took else 0.5
        is_replaced = bool(reserve) or name not in kept
        nothing = LEARNS if reserve else NOTHING
        changed = nothing | (ud if name == "ud" else {}) if is_replaced else kept[name]
        graph = with_agents_on_call(spec, agents, changed, reserve)
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            decision = Decision(name, share, np.random.default_rng(seed))
            for sequence in sequences:
                decision.truth = sequence.truth
                decision.score = 1.0
                with ExitStack() as stack:
                    if is_replaced:
                        stack.enter_context(replaced(decision))
                    result = run_graph(name, graph, sequence, seed)
                looked = result.agents - (len(agents_of(graph)) - len(agents))
                if name == ("ud" if reserve else "rule"):
                    took.append(looked / len(agents))
                yield result, looked / len(agents)


def agents_of(spec: GraphSpec) -> list[str]:
    """The agents of the first plate."""
    return [name for name, node in next(iter(spec.targets.values())).nodes.items() if hasattr(node, "agent")]


def main() -> None:
    """Run the policies, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="deep")
    parser.add_argument("--agents", default="network", help="those on call, with commas")
    parser.add_argument("--reserve", default="{}", help="further agents, YAML")
    parser.add_argument("--rule", default="3,0.8,0.026", help="every, agree and above (ud_box) of `on_call`")
    parser.add_argument("--policies", default=POLICIES)
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--strata", default="chosen on,untuned", help=f"of {', '.join(STRATA)}")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--max-frames", type=int)
    parser.add_argument("--looks", type=Path, default=LOOKS)
    parser.add_argument("--passes", type=Path, metavar="FILE", help="write every pass, a JSON object a line")
    options = parser.parse_args()
    on_one_thread()
    strata = {name: STRATA[name] for name in options.strata.split(",")}
    options.names = sorted({name for of_stratum in strata.values() for name in of_stratum})
    every, agree, ud_box = options.rule.split(",")
    rule = {"every": int(every), "agree": float(agree), "above": {"ud_box": float(ud_box)}}
    _, spec = read_graph(options.graph)
    look = {"half": options.strata, "graphs": f"{options.graph} {digest(spec)}", "frames": options.max_frames}
    note(options.looks, **look, seeds=str(options.first_seed), why=options.why)
    done, looked = list[Pass](), dict[tuple[str, str], list[float]]()
    agents = tuple(options.agents.split(","))
    for result, share in run_policies(spec, agents, rule, yaml.safe_load(options.reserve), options):
        done.append(result)
        looked.setdefault((result.tracker, result.sequence), []).append(share)
        if options.passes:
            with options.passes.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(result)) + "\n")
    print(environment(), file=sys.stderr)
    means = means_of(done)
    for names in strata.values():
        here = [name for name in names if any(each.sequence == name for each in done)]
        rows = []
        for name in means:
            passes = [each for each in done if each.tracker == name and each.sequence in here]
            taken = np.mean([np.mean(looked[name, sequence]) for sequence in here])
            compare = partial(describe_difference, means[name])
            against = [
                "" if other not in means or name == other else compare(means[other], here)
                for other in ("random", NEVER, ALWAYS)
            ]
            rows.append([*row_of(name, passes), f"{taken:.3f}", *against])
        print(table([*HEAD, "looked in", "- random", "- never", "- always"], rows), end="\n\n")


if __name__ == "__main__":
    main()
