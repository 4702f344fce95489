"""The page of all installed graphs, made from their files.

python docs/make_pages/graphs.py > docs/graphs.md
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graphs import graphs_about
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.observation.detector import GIVEN

CROWDS = "benchmarks/crowds.md"
MEASURED: Mapping[str, str] = MappingProxyType(
    {
        "general": "[success AUC .681 on 25 real sequences](benchmarks/real_video.md)",
        "two_squares_velocity": "[47 of 50 random crossings](benchmarks/scenes.md#example-1)",
        "two_squares": "[50 of 50 crossings as stated, 39 of 50 random ones](benchmarks/scenes.md)",
        "kalman_detections": f"[MOTA .839 on noisy detections]({CROWDS}#many-people-in-a-real-sequence)",
        "people_detections": f"[MOTA .839 on noisy detections]({CROWDS}#many-people-in-a-real-sequence)",
        "sort": f"[IDF1 .998 or more against `trackers`]({CROWDS}#trackers-of-the-field)",
        "bytetrack": f"[IDF1 1.000 against `trackers`]({CROWDS}#trackers-of-the-field)",
        "oc_sort": f"[IDF1 .984 or more against `trackers`]({CROWDS}#trackers-of-the-field)",
        "orange_and_gray_detected": "[both squares in 49 of 50 scenes](targets.md)",
    }
)
"""Graph -> what a page has measured, with that page."""

DEPTH = ("stereo",)
NETWORK = ("siamese", "siamese_box", "onnx")

HEAD = """\
# The installed graphs

![Two people in five frames, with boxes, hypotheses and active agents](figures/people_strip.png)

<!-- Made by python docs/make_pages/graphs.py; do not edit. -->

Start with `general` for one target of unknown appearance, with `kalman_detections` if you have a detector's
boxes, and with `people` if you have [a detection network](detectors.md#onnx). `sort`, `bytetrack` and
`oc_sort` are [published trackers](field_trackers.md). The others belong to scenes of `bayesnet-track demo`
and show one thing each: copy the nearest one with `bayesnet-track init --from NAME`. `bayesnet-track graph
NAME --formula` prints the density of a graph.

Cost is the declared cost of all agents for 1000 hypotheses of 60 × 60 px, in ms: a figure to compare graphs
by. [Benchmarks](benchmarks/speed.md) have measured times. An empty accuracy has not been measured.
"""


def graph_page() -> str:
    """The page as Markdown."""
    rows = ["| graph | for | needs | beliefs | cost, ms | accuracy |", "|---|---|---|---|---:|---|"]
    rows += [_row(name, about, load_graph(name)) for name, about in graphs_about().items()]
    return f"{HEAD}\n" + "\n".join(rows) + "\n"


def _row(name: str, about: str, graph: CheckedGraph) -> str:
    plates = list(graph.targets.values())
    needs = dict.fromkeys(need for plate in plates for need in _needs(plate))
    beliefs = dict.fromkeys(belief for plate in plates for belief in _beliefs(plate))
    cost = sum(_cost(plate) for plate in plates)
    cells = [f"`{name}`", about, ", ".join(needs), ", ".join(beliefs), f"{cost:.3g}", MEASURED.get(name, "")]
    return f"| {' | '.join(cells)} |"


def _cues(plate: CheckedTarget) -> Sequence[str]:
    return [plate.agent(agent).agent.cue for agent in plate.agents]


def _needs(plate: CheckedTarget) -> Iterator[str]:
    birth, cues = plate.spec.birth, _cues(plate)
    declared = installed_cues(cues)
    if birth is None:
        yield "a start box"
    elif birth.detector.detector == GIVEN:
        yield "a file of detections"
    elif birth.detector.detector in NETWORK:
        yield "the file of a network"
    if any(declared[cue].needs_color for cue in cues):
        yield "colour"
    if any(cue in DEPTH for cue in cues):
        yield "a stereo pair or depth"
    if any(cue in NETWORK for cue in cues):
        yield "the files of a network"


def _beliefs(plate: CheckedTarget) -> Iterator[str]:
    belief = getattr(plate.spec.nodes[plate.root], "belief", None)
    yield str(getattr(belief, "kind", "particles"))


def _cost(plate: CheckedTarget) -> float:
    declared = installed_cues(_cues(plate))
    return sum(declared[cue].cost_ms for cue in _cues(plate))


if __name__ == "__main__":
    sys.stdout.write(graph_page())
