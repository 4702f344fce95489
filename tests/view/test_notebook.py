"""How graphs, plans and runs show themselves in a notebook: well formed, escaped, saying what is there."""

import xml.etree.ElementTree as ET

import pytest

from bayesnet_track import GraphSpec, load_graph, open_run
from bayesnet_track.cli.main import main
from bayesnet_track.engine.step import make_engine
from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.view.notebook import run_html, table

HOSTILE = "<script>alert(1)</script>&\"'"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two targets, 10 frames."""
    out = tmp_path_factory.mktemp("notebook") / "run"
    assert main(["demo", "orange_and_gray", "--end", "10", "--quiet", "--out", str(out)]) == 0
    return open_run(out)


def parsed(html):
    """The HTML as XML: every tag closed, every text escaped; what could run is not there."""
    tree = ET.fromstring(f"<div>{html}</div>")
    assert not [
        one
        for one in tree.iter()
        if one.tag.endswith("script") or any(k.startswith("on") for k in one.attrib)
    ]
    ids = [one.attrib["id"] for one in tree.iter() if "id" in one.attrib]
    assert len(ids) == len(set(ids))
    return "".join(tree.itertext())


def test_a_graph_shows_every_net():
    graph = load_graph("orange_and_gray")
    html = graph._repr_html_()
    text = parsed(html)
    assert html.count("<svg") == len(graph.targets) == 2
    for plate in graph.targets.values():
        assert all(agent in text for agent in plate.agents)
    parsed(graph._repr_svg_())


def test_a_specification_shows_its_net_or_its_errors():
    spec = load_graph("two_squares").spec
    assert spec._repr_html_() == load_graph("two_squares")._repr_html_()
    data = spec.model_dump()
    broken = GraphSpec(**{**data, "about": HOSTILE, "name": "broken", "targets": {"t": {"nodes": {"t": {}}}}})
    text = parsed(broken._repr_html_())
    assert "broken cannot be run" in text and "motion" in text


def test_what_a_graph_is_for_is_escaped():
    spec = load_graph("two_squares").spec.model_copy(update={"about": HOSTILE})
    assert HOSTILE in parsed(spec._repr_html_())


def test_a_plan_is_a_table_of_its_steps():
    graph = load_graph("color_fusion")
    (plate,) = graph.targets.values()
    (compiled,) = make_engine(graph, 0).plates.values()
    text = parsed(compile_plan(plate, plate.agents[:1], compiled.cues)._repr_html_())
    assert plate.agents[0] in text and plate.root in text and "off" in text


def test_a_run_shows_figures_timelines_and_reasons(run):
    html = run._repr_html_()
    text = parsed(html)
    assert html.count("<svg") == 2 and "seed 0" in text and "orange 1 starts, " in text
    assert str(run.directory.path) in text
    parsed(run.timeline("2"))
    assert repr(run) == f"Run({run.name!r}: 10 frames, 2 targets)"  # what a notebook keeps beside the HTML


def test_a_run_that_has_just_begun(run):
    from types import SimpleNamespace

    parsed(run_html(SimpleNamespace(name=HOSTILE, events=[], metrics=[], seconds={}, costs_ms={})))


def test_cells_are_escaped():
    assert parsed(table([(HOSTILE, HOSTILE)], (HOSTILE, "b"))) == HOSTILE + "b" + HOSTILE * 2


def test_a_page_is_shown_in_a_frame_that_is_cut_off_from_the_notebook(run):
    page = run.page(height=500, largest=1)
    (frame,) = ET.fromstring(f"<div>{page._repr_html_()}</div>".replace("\n", "&#10;"))
    assert frame.tag == "iframe" and "height:500px" in frame.attrib["style"]
    assert frame.attrib["sandbox"] == "allow-scripts allow-downloads"  # no origin: nothing of the notebook
    assert frame.attrib["srcdoc"] == page.html and frame.attrib["title"] == run.name
    assert repr(page) == f"<page of {run.name}, {len(page.html) / 1e6:.1f} MB>"
