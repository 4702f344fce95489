"""The page of all installed graphs is the one that their files make."""

from pathlib import Path

from bayesnet_track.graphs import graph_names
from make_pages.graphs import MEASURED, graph_page

PAGE = Path(__file__).parents[2] / "docs" / "graphs.md"


def test_the_committed_page_is_the_generated_one():
    again = "python docs/make_pages/graphs.py > docs/graphs.md"
    assert PAGE.read_text(encoding="utf-8") == graph_page(), f"write it again: {again}"


def test_each_graph_has_a_row_and_what_is_measured_is_of_one():
    page = graph_page()
    assert all(f"| `{name}` | " in page for name in graph_names())
    assert set(MEASURED) <= set(graph_names())
