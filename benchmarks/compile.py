"""What it costs to compile a net again after a reconfiguration: ten nodes, every agent on or some off.

python benchmarks/compile.py [--repeat 2000]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.observation.cue import Cue, installed_cues

NODES = {
    "target": {"motion": {"random_walk": {"sd_box": {"x": 0.1, "y": 0.1}}}, "fuse": "product"},
    "body": {"parent": "target", "fuse": {"latent": {"given": {"sd_px": {"x": 4.0, "y": 4.0}}}}},
    "color": {"parent": "body", "fuse": "pool"},
    "texture": {"parent": "body", "fuse": {"pool": {"gray": 2.0, "fine": 1.0}}},
    "histogram": {"parent": "color", "agent": "color_histogram"},
    "coarse": {"parent": "color", "agent": {"color_histogram": {"bins": 16}}},
    "gray": {"parent": "texture", "agent": "intensity"},
    "fine": {"parent": "texture", "agent": "intensity"},
    "blobs": {"parent": "target", "agent": "color_blobs"},
    "motion": {"parent": "target", "agent": "motion"},
}
LIMIT_US = 1000.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the median and the slowest hundredth; 1 when the median is above the limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=2000)
    repeat = parser.parse_args(arguments).repeat
    spec = GraphSpec.model_validate({"name": "ten_nodes", "targets": {"target": {"nodes": NODES}}})
    plate = check_graph(spec).targets["target"]
    cues: dict[str, Cue] = {
        agent: installed_cues()[plate.agent(agent).agent.cue].make(plate.parameters[agent])
        for agent in plate.agents
    }
    worst = 0.0
    for label, active in (("all six agents", plate.agents), ("two agents", ("histogram", "motion"))):
        taken = np.empty(repeat)
        for k in range(repeat):
            started = time.perf_counter()
            compile_plan(plate, active, cues)
            taken[k] = time.perf_counter() - started
        median, slow = 1e6 * np.quantile(taken, [0.5, 0.99])
        worst = max(worst, median)
        print(f"{len(plate.order)} nodes, {label}: {median:.0f} us (99 %: {slow:.0f}); limit {LIMIT_US:.0f}")
    return int(worst > LIMIT_US)


if __name__ == "__main__":
    raise SystemExit(main())
