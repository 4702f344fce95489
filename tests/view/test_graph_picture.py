"""The net's picture: no overlaps, everything inside, active and inactive told apart, names escaped."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import load_graph
from bayesnet_track.view.graph_layout import MARGIN, lay_out, pool_weights
from bayesnet_track.view.graph_picture import graph_image, graph_svg, with_factors

SVG = "{http://www.w3.org/2000/svg}"


@st.composite
def trees(draw):
    """Nodes of a valid plate: inference nodes hung anywhere, then agents below every childless one."""
    suffix = st.text("Wi_0", max_size=50)
    inference = ["r" + draw(suffix)]
    nodes = {inference[0]: {"fuse": "product"}}
    for number in range(draw(st.integers(0, 5))):
        name = f"n{number}" + draw(suffix)
        fuse = draw(st.sampled_from(["pool", "product", {"latent": {"given": {}}}]))
        nodes[name] = {"parent": draw(st.sampled_from(inference)), "fuse": fuse}
        inference.append(name)
    with_child = {value["parent"] for value in nodes.values() if "parent" in value}
    parents = [name for name in inference if name not in with_child]
    parents += draw(st.lists(st.sampled_from(inference), max_size=6))
    for number, parent in enumerate(parents):
        nodes[f"a{number}" + draw(suffix)] = {
            "parent": parent,
            "agent": draw(st.sampled_from(["motion", "x" * 40])),
        }
    return nodes


@given(nodes=trees(), data=st.data())
def test_layouts_of_any_tree(checked, nodes, data):
    target = checked(nodes)
    active = set(data.draw(st.lists(st.sampled_from(target.agents))))
    layout = lay_out(target, active)
    assert [node.name for node in layout.nodes] == list(target.order)
    boxes = [(n.x - n.w / 2, n.y - n.h / 2, n.x + n.w / 2, n.y + n.h / 2) for n in layout.nodes]
    boxes += [(f.x - f.w / 2, f.y - f.h / 2, f.x + f.w / 2, f.y + f.h / 2) for f in layout.forks]
    for number, (left, top, right, bottom) in enumerate(boxes):
        assert left >= MARGIN - 1e-6 and right <= layout.width - MARGIN + 1e-6
        assert top >= MARGIN - 1e-6 and bottom <= layout.height - MARGIN + 1e-6
        for other in boxes[:number]:
            assert left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]
    place = {node.name: node for node in layout.nodes}
    assert len(layout.edges) == len(target.order) - 1
    for child, parent in target.parent.items():
        assert parent is None or place[child].y > place[parent].y + place[parent].h
    for node in layout.nodes:
        assert 0.6 * 15 * len(node.name) <= node.w - 20  # a fixed-width letter is 0.6 em
    alive = {node.name for node in layout.nodes if node.active}
    assert {name for name in alive if name in target.agents} == active
    assert {target.parent[name] for name in alive} - {None} <= alive


def test_svg_of_the_colour_net(color_fusion):
    svg = graph_svg(color_fusion, {"histogram", "blobs", "intensity"})
    root = ET.fromstring(svg)
    assert root.find(f"{SVG}title").text == "Bayes net of square"
    assert root.find(f"{SVG}desc").text == (
        "square above histogram, blobs, flow, intensity; active: histogram, blobs, intensity"
    )
    shapes = {}
    for group in root.iter(f"{SVG}g"):
        shape, *texts = group
        shapes[texts[0].text] = (shape.tag.removeprefix(SVG), "stroke-dasharray" in shape.attrib)
    assert shapes == {
        "square": ("ellipse", False),
        "color": ("ellipse", False),
        "histogram": ("rect", False),
        "blobs": ("rect", False),
        "flow": ("rect", True),
        "intensity": ("rect", False),
        "belief": ("ellipse", False),
        "active agent": ("rect", False),
        "inactive agent": ("rect", True),
    }
    words = [text.text for text in root.iter(f"{SVG}text")]
    assert words.count("0.50") == 2 and "product" in words and "pool" in words
    assert "particles, random walk" in words and "color_histogram" in words


def test_pool_weights_are_over_what_is_alive(checked, color_fusion):
    assert pool_weights(color_fusion, "color", {"histogram", "blobs"}) == {"histogram": 0.5, "blobs": 0.5}
    assert pool_weights(color_fusion, "color", {"blobs"}) == {"blobs": 1.0}
    assert pool_weights(color_fusion, "square", {"flow"}) == {}
    weighed = checked(
        {
            "root": {"fuse": {"pool": {"a": 3.0, "b": 1.0, "c": 4.0}}},
            **{name: {"parent": "root", "agent": "motion"} for name in "abc"},
        }
    )
    assert pool_weights(weighed, "root", {"a", "b"}) == {"a": 0.75, "b": 0.25}


def test_a_hostile_plate_name_is_text(checked):
    nodes = {"r": {}, "a": {"parent": "r", "agent": "<script>&\"'"}}
    root = ET.fromstring(graph_svg(checked(nodes, name="</title><script>"), set()))
    assert root.find(f"{SVG}title").text == "Bayes net of </title><script>"
    assert not list(root.iter(f"{SVG}script"))
    assert "<script>&\"'" in [text.text for text in root.iter(f"{SVG}text")]


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_pixels_show_the_same_layout(color_fusion, scale):
    active = {"histogram", "blobs", "intensity"}
    layout = lay_out(color_fusion, active)
    image = graph_image(color_fusion, active, scale)
    assert image.shape == (round(layout.height * scale), round(layout.width * scale), 3)
    rim = round((MARGIN - 4) * scale)
    for edge in (image[:rim], image[:, :rim], image[:, -rim:]):
        assert (edge == 255).all()
    for node in layout.nodes:
        row, column = round((node.y - node.h / 2 + 5) * scale), round(node.x * scale)
        blue, green, red = image[row, column].astype(int)
        if not node.active:
            assert (blue, green, red) == (255, 255, 255)
        else:
            assert (green > blue and green > red) if node.is_agent else blue > red
        inside = image[
            row : round((node.y + 20) * scale), round((node.x - 40) * scale) : round((node.x + 40) * scale)
        ]
        assert np.ptp(inside.astype(int).sum(axis=2)) > 150  # the name


def test_a_latent_node_says_how_it_holds_its_state(fakes):
    node = {"parent": "root", "fuse": {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}}}}
    for belief, note in (
        (None, "own state"),
        ("gaussian", "own state, gaussian"),
        ("grid", "own state, grid"),
    ):
        own = node if belief is None else {**node, "belief": belief}
        plate, _ = fakes.plate({"root": {}, "part": own, "a": "part"})
        assert f">{note}<" in graph_svg(plate, {"a"})


def test_a_factor_is_a_rectangle_below_its_node():
    target = load_graph("road").targets["target"]
    layout = lay_out(with_factors(target), set())
    place = {node.name: node for node in layout.nodes}
    assert list(place) == ["target", "color", "road"]
    assert (place["road"].is_factor, place["road"].note, place["road"].active) == (True, "factor", True)
    assert place["road"].y == place["color"].y
    assert place["color"].x < place["road"].x
    assert len(layout.edges) == 2
    assert 'rx="0' in graph_svg(target, set())
    assert graph_image(target, set()).shape[2] == 3
