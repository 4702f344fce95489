"""Planes in words."""

import re

from bayesnet_track.cli.main import main
from bayesnet_track.graphs import graphs_about


def test_no_plan_speaks_python(capsys):
    for name in graphs_about().keys() - {"deep"}:  # which has no plan without its files
        assert main(["graph", name]) == 0
    planes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  plane  ")]
    assert "  plane    whole frame" in planes and "  plane    hue (min chroma 30, median 1 px)" in planes
    assert any("needs depth" in line for line in planes)
    assert not [line for line in planes if re.search(r"[A-Z_=]|\(\)", line)]
