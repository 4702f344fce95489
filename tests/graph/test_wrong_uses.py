"""Wrong uses of the language's further keys, as people write them, and what `validate` says, word for word.

A case of `messages/wrong_uses.txt` is ``=== key: name``, lines of the graph as they are replaced (``-`` by
``+``), and the lines that the terminal shows, each after ``--> `` and without file and excerpt.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.explain import describe_error
from bayesnet_track.graph.text.messages import GraphError

TABLE = Path(__file__).parent / "messages" / "wrong_uses.txt"
GRAPH = """\
bayesnet: 1
name: m
constants: {k: 3}
inputs: {pan: {file: camera.csv}}
targets:
  p:
    nodes:
      p:
        belief: {gaussian: {filter: extended, gate: 1}}
        motion: {constant_velocity: {sd_velocity_px: 1}}
        fuse: product
      s: {parent: p, agent: {readings: {file: radio.csv, sd: {x: 2, y: 2}}}}
"""
FILES = {"camera.csv": "frame,pan\n0,1\n5,2\n", "radio.csv": "frame,x,y,u\n1,61,60,61\n2,62,60,62\n"}


def cases():
    for part in TABLE.read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        shown = [line.removeprefix("--> ") for line in lines if line.startswith("--> ")]
        old = "\n".join(line[1:] for line in lines if line.startswith("-") and not line.startswith("-->"))
        new = "\n".join(line[1:] for line in lines if line.startswith("+"))
        assert GRAPH.count(old) == 1, name
        yield pytest.param(GRAPH.replace(old, new), shown, id=name)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shown_of(folder, text):
    (folder / "g.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(GraphError) as error:
        load_graph("g.yaml")
    lines = describe_error(error.value).splitlines()
    return [line.strip().removeprefix("g.yaml:") for line in lines if line.startswith(("g.yaml", "  hint"))]


@pytest.mark.parametrize(("text", "shown"), list(cases()))
def test_a_wrong_use_is_refused_with_what_to_do(text, shown, folder):
    assert shown_of(folder, text) == shown


def test_the_graph_itself_is_right(folder):
    (folder / "g.yaml").write_text(GRAPH, encoding="utf-8")
    assert set(load_graph("g.yaml").targets) == {"p"}


def test_every_key_has_ten_wrong_uses():
    counts = Counter(str(case.id).partition(":")[0] for case in cases())
    assert len(counts) == 9 and min(counts.values()) >= 10
