"""Masks of factors: where their files are looked for, and every message (`messages/masks.txt`)."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.checks.factors import masks_of
from bayesnet_track.graph.checks.run import check, check_graph
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.graph.text.formula import formula_text
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graphs import graph_folder
from bayesnet_track.observation.image_files import AnyMask

HEAD = """bayesnet: 1
name: g
targets:
  t:
    nodes:
      s: {motion: {random_walk: {sd_px: {x: 9}}}}
      a: {parent: s, agent: hue}
"""
TABLE = (Path(__file__).parent / "messages" / "masks.txt").read_text("utf-8")
CASES = [part.strip().split("\n") for part in TABLE.split("=== ")[1:]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("graph")
    gray = np.full((6, 8), 200, dtype=np.uint8)
    cv2.imwrite(str(folder / "road.png"), gray)
    data = (folder / "road.png").read_bytes()
    (folder / "cut.png").write_bytes(data[:-12])
    (folder / "huge.png").write_bytes(data[:16] + struct.pack(">II", 20000, 20000) + data[24:])
    cv2.imwrite(str(folder / "deep.png"), gray.astype(np.uint16) * 200)
    cv2.imwrite(str(folder / "clear.png"), np.dstack([gray] * 4))
    (folder / "text.png").write_text("road", encoding="utf-8")
    (folder / "folder").mkdir()
    return folder


def of(folder, node, cues):
    (folder / "g.yaml").write_text(f"{HEAD}      {node}\n", encoding="utf-8")
    return check(*read_graph(folder / "g.yaml"), cues)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_messages(folder, cues, case):
    with pytest.raises(GraphError) as error:
        of(folder, case[1], cues)
    said = str(error.value).replace(f"{folder}/g.yaml:", "--> ").splitlines()
    assert said == case[2:]


def test_a_mask_alone_is_its_value_at_the_centre(folder, cues):
    graph = of(folder, "f: {parent: s, mask: road.png}", cues)
    assert graph.masks["road.png"].gray.shape == (6, 8)
    assert graph.targets["t"].factors["f"].mask is graph.masks["road.png"]
    assert "f(s_t) = mask(x, y), mask: road.png, 8x6 px" in formula_text(graph.targets["t"])
    assert 'mask: "road.png"' in graph.text


def test_a_mask_is_looked_for_beside_the_graph_then_among_the_installed_graphs(tmp_path):
    assert load_graph("road_mask").masks["road_mask.png"].path == Path(graph_folder(), "road_mask.png")
    shutil.copy(Path(graph_folder(), "road_mask.yaml"), tmp_path)
    assert load_graph(tmp_path / "road_mask.yaml").masks["road_mask.png"].path.parent == Path(graph_folder())
    shutil.copy(Path(graph_folder(), "road_mask.png"), tmp_path)
    assert load_graph(tmp_path / "road_mask.yaml").masks["road_mask.png"].path.parent == tmp_path


def test_a_graph_in_python_has_its_mask_from_where_the_program_runs(folder, cues, monkeypatch):
    nodes = {
        "s": {"motion": "constant_velocity"},
        "a": {"parent": "s", "agent": "hue"},
        "f": {"parent": "s", "mask": "road.png"},
    }
    graph = {"name": "g", "targets": {"t": {"nodes": nodes}}}
    with pytest.raises(GraphError, match=r"mask road\.png: No such file"):
        check_graph(graph, cues)
    monkeypatch.chdir(folder)
    assert set(check_graph(graph, cues).masks) == {"road.png"}


def test_known_masks_are_not_read_again():
    masks = masks_of(load_graph("road_mask").spec, Path("/nowhere"), AnyMask())
    assert masks["road_mask.png"].gray.shape == (1, 1)
    graph = load_graph("road_mask")
    assert change_graph(graph.text, [], masks=graph.masks).masks == graph.masks
