"""A rule by which agents switch themselves is one file and one line: all else follows from them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bayesnet_track

pytestmark = pytest.mark.slow

RULE = '''\
"""`idle_check`: an agent that contributes next to nothing stops itself."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field

from bayesnet_track.graph.rules.agent_rule import AgentMeasures, AgentPlace, AgentRule, RuleFlaw
from bayesnet_track.graph.settings.base import FrameCount, Positive
from bayesnet_track.observation.cue import Floats


class IdleCheck(AgentRule):
    """An agent that hardly changes the belief stops itself."""

    quantity = "contribution"
    unit = " nats"
    relation = "<"

    below_nats: Positive = Field(description="contribution below which it is idle")
    frames: FrameCount = Field(default=5, description="consecutive frames before it stops")
    rest: FrameCount = Field(default=20, description="frames before it may be switched on again")

    @property
    def level(self) -> float:
        """The level of its contribution, nats."""
        return self.below_nats

    def values(self, measures: AgentMeasures) -> Floats:
        """(T,) its contribution, nats."""
        return measures.measured("contribution")

    def flaws(self, place: AgentPlace) -> Iterator[RuleFlaw]:
        """The only agent never stops itself."""
        if not place.siblings:
            found = f"{place.name} is the only agent, and never stops itself"
            yield RuleFlaw("below_nats", found, "no such rule")
'''
ANCHOR = (
    '    self_check: SelfCheck | None = Field(default=None, description="stop when uncertain of itself")\n'
)
FIELD = """\
    idle_check: IdleCheck | None = Field(default=None, description="stop when of no use")
"""
IMPORT = "from bayesnet_track.graph.rules.idle_check import IdleCheck\n"

GRAPH = """
bayesnet: 1
name: idle
targets:
  square:
    nodes:
      square: {motion: {random_walk: {sd_px: {x: 10, y: 10}}}, ud_fields: [x, y], fuse: product}
      histogram: {parent: square, agent: color_histogram}
      shape: {parent: square, agent: template, idle_check: {below_nats: 1000, frames: 3}}
"""
PROGRAM = """
import sys
import numpy as np
from bayesnet_track import Tracker, load_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.graph.text.write import graph_schema
from bayesnet_track.graph.text.write import write_graph

frames = [np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)] * 8
tracker = Tracker("idle.yaml", seed=1)
tracker.init(frames[0], (20, 20, 20, 20))
for frame in frames[1:]:
    tracker.update(frame)
    print(*(event.describe() for event in tracker.events), sep="\\n")
print("schema", "idle_check" in str(graph_schema()))
fixed = change_graph(open("idle.yaml").read(), [], adaptation=False)
print("without", "idle_check" in write_graph(fixed.spec))
alone = "".join(line for line in open("idle.yaml") if "histogram" not in line)
open("alone.yaml", "w").write(alone)
try:
    load_graph("alone.yaml")
except GraphError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def installation(tmp_path_factory):
    """A copy of the package with one rule more: its folder."""
    folder, source = tmp_path_factory.mktemp("package"), Path(bayesnet_track.__file__).parent
    copy, ignored = folder / "bayesnet_track", shutil.ignore_patterns("__pycache__")
    shutil.copytree(source, copy, ignore=ignored)
    for top in ("cues", "graphs"):
        shutil.copytree(source.parent / top, copy / top, ignore=ignored, dirs_exist_ok=True)
    (copy / "graph" / "rules" / "idle_check.py").write_text(RULE)
    net = copy / "graph" / "settings" / "net.py"
    text = net.read_text()
    assert text.count(ANCHOR) == 1
    text = text.replace(ANCHOR, ANCHOR + FIELD).replace(
        "from bayesnet_track.graph.rules.self", IMPORT + "from bayesnet_track.graph.rules.self"
    )
    net.write_text(text)
    (folder / "idle.yaml").write_text(GRAPH)
    return folder


def run(installation, *arguments):
    """What a program of that installation prints."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=installation, env={**os.environ, "PYTHONPATH": str(installation)}, capture_output=True, text=True,
        check=False, timeout=300,
    )  # fmt: skip
    return done.stdout + done.stderr


def test_a_rule_of_one_file_and_one_line_is_checked_decides_and_is_told(installation):
    said = run(installation, "-c", PROGRAM)
    stopped = "shape: its contribution "
    (sentence,) = [line for line in said.splitlines() if line.startswith(stopped)]
    assert " nats < 1000 for 3 frames → stopped itself; may be switched on again from frame " in sentence
    assert "; would have continued at idle_check ≤ " in sentence
    assert "schema True" in said and "without False" in said
    assert "shape: idle_check.below_nats: shape is the only agent" in said


def test_figures_of_the_architecture_page():
    page = (Path(bayesnet_track.__file__).parents[1] / "docs" / "architecture.md").read_text("utf-8")
    assert "| a rule of an agent | two files of the package" in page
