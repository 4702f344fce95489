"""Values of a graph changed by a path: what may be left out, what is refused and how it says so."""

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.change import ChangeError, change_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graph.text.write import differences

TEXT = load_graph("two_squares").text


def changed(*changes, adaptation=True):
    return [str(one) for one in differences(TEXT, change_graph(TEXT, changes, adaptation).text)]


@pytest.mark.parametrize("before", ["", "square.nodes.", "targets.square.nodes."])
def test_what_is_clear_may_be_left_out(before):
    path = f"{before}square.adapt.activate.above.ud_px2"
    assert changed(f"{path}=200") == ["targets.square.nodes.square.adapt.activate.above.ud_px2: 130 → 200"]


def test_what_is_not_written_is_added_and_a_bare_word_gets_settings():
    assert changed("square.lost.above.ud_box=2") == [
        "targets.square.nodes.square.lost: not written → {above: {ud_box: 2}}"
    ]
    assert changed("square.belief.particles.size=80") == [
        "targets.square.nodes.square.belief: particles → {particles: {size: 80}}"
    ]


def test_a_key_of_the_plate_beside_a_root_of_the_same_name():
    text = load_graph("kalman_detections").text
    plate = next(iter(load_graph("kalman_detections").targets))
    found = differences(text, change_graph(text, [f"{plate}.death.unseen_frames=7"]).text)
    assert [one.path for one in found] == [f"targets.{plate}.death.unseen_frames"]


def test_without_adaptation_every_agent_is_on_and_nothing_switches_it():
    plate = change_graph(TEXT, [], adaptation=False).targets["square"]
    assert all(plate.agent(agent).active for agent in plate.agents)
    assert set(plate.governor.values()) == {None}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("sqare.adapt=1", "nothing is called sqare; .* nearest: square"),
        ("coherent_px=2", "nothing is called coherent_px; .* nearest: motion.agent.motion.coherent_px"),
        ("xyz=1", "a path begins with one of them, as in NODE.belief.particles.size=1000"),
        ("square", "PATH=VALUE is needed"),
        ("square.about={", "is no value"),
    ],
)
def test_paths_that_lead_nowhere(change, said):
    with pytest.raises(ChangeError, match=said):
        change_graph(TEXT, [change])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "square.adapt.activat.above.ud_px2=4",
            "changes:targets.square.nodes.square.adapt.activat: .* nearest: activate",
        ),
        ("square.adapt.activate.above.ud_px2=many", "ud_px2 is 'many'; allowed: a number above 0"),
        ("color.agent.color_histogram.bin=9", "unknown key 'bin'.*nearest: bins"),
    ],
)
def test_values_that_the_language_refuses(change, said):
    with pytest.raises(GraphError, match=said):
        change_graph(TEXT, [change])
