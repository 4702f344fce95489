"""Planes in words."""

import re

from bayesnet_track import load_graph
from bayesnet_track.cli.commands.graphs import _active, _plan
from bayesnet_track.graphs import graphs_about


def test_no_plan_speaks_python():
    said = ""
    for name in graphs_about().keys() - {"deep"}:  # which has no plan without its files
        for plate in load_graph(name).targets.values():
            said += _plan(plate, _active(plate), False) + "\n"
    planes = [line for line in said.splitlines() if line.startswith("  plane  ")]
    assert "  plane    whole frame" in planes and "  plane    hue (min chroma 30, median 1 px)" in planes
    assert any("needs depth" in line for line in planes)
    assert not [line for line in planes if re.search(r"[A-Z_=]|\(\)", line)]
