"""Modes beside joins, parts and factors that read them: exact where enumeration is possible."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesnet_track import Start, Tracker, load_graph, track
from bayesnet_track.graph.text.messages import GraphError

BLANK = np.random.default_rng(5).integers(30, 60, (120, 240, 3), np.uint8)
MODES = {
    "still": {"mean_frames": 4},
    "jumpy": {"mean_frames": 4, "motion": {"random_walk": {"sd_px": {"x": 12}}}},
}
SDS = {"still": 2.0, "jumpy": 12.0}


def readings(path, **columns):
    names = ["frame", *columns]
    rows = zip(range(len(next(iter(columns.values())))), *columns.values(), strict=True)
    path.write_text(
        "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]), encoding="utf-8"
    )
    return str(path)


def kind(name, file, **further):
    return {
        "nodes": {
            name: {
                "belief": {"particles": {"size": 6000}},
                "motion": {"random_walk": {"sd_px": {"x": 2}}},
                "modes": MODES,
                "estimate": "mean",
                "fuse": "product",
            },
            f"s{name}": {
                "parent": name,
                "agent": {"readings": {"file": file, "sd": {"x": 3}, "floor": 1e-12}},
            },
            **further,
        }
    }


def test_a_factor_of_two_targets_says_in_which_modes_they_are(tmp_path):
    """Both are seen where they were; that they should be 40 px apart says that one has jumped."""
    images = tmp_path / "images"
    images.mkdir()
    for number in range(2):
        assert cv2.imwrite(str(images / f"{number:03}.png"), BLANK)
    files = [readings(tmp_path / f"{k}.csv", x=[at, at]) for k, at in (("a", 60), ("b", 115))]
    graph = {
        "bayesnet": 1,
        "name": "pair",
        "targets": {"a": kind("a", files[0]), "b": kind("b", files[1])},
        "joins": [{"between": ["a", "b"], "factor": "normal(b.x - a.x, 40, 4)", "when": {"overlap": 0}}],
    }
    starts = [Start((50, 50, 20, 20), "a"), Start((90, 50, 20, 20), "b")]
    shares = []
    for seed in range(5):
        results = list(track(load_graph(graph), str(images), starts, seed=seed))
        shares.append([one.modes["jumpy"] for one in results[1].targets])
    exact = {}
    look = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]])
    chain = 0.5  # as many frames in each mode: either is as probable in the long run, and stays so
    for a, b in product(SDS, SDS):
        spread = np.diag([SDS[a] ** 2, SDS[b] ** 2])
        cov = look @ spread @ look.T + np.diag([9.0, 9.0, 16.0])
        centre = np.array([59.5, 99.5])
        exact[a, b] = chain**2 * multivariate_normal.pdf([60.0, 115.0, 40.0], look @ centre, cov)
    total = sum(exact.values())
    wanted = [sum(p for pair, p in exact.items() if pair[k] == "jumpy") / total for k in range(2)]
    found = np.array(shares)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - wanted) < 4 * error + 0.01).all(), (found.mean(axis=0), wanted)


@pytest.mark.parametrize(
    "belief", [{"gaussian": {"filter": "kalman", "gate": 1}}, {"particles": {"size": 4000}}]
)
def test_a_factor_may_read_the_mode(tmp_path, belief):
    """In the first frame it multiplies the odds of the mode: exactly, of Gaussians."""
    file, odds = readings(tmp_path / "a.csv", x=[60, 66], y=[60, 60]), []
    for expression in ("1", "where(mode == jumpy, 1, 0.25)"):
        target = kind("a", file, f={"parent": "a", "factor": expression})
        target["nodes"]["a"]["belief"] = belief
        tracker = Tracker(load_graph({"bayesnet": 1, "name": "m", "targets": {"a": target}}))
        tracker.init(BLANK, (50, 50, 20, 20))
        tracker.update(BLANK)
        modes = tracker.targets[0].modes
        odds.append(modes["jumpy"] / modes["still"])
    assert odds[1] / odds[0] == pytest.approx(4.0, rel=1e-6)


def test_a_part_deviates_in_every_mode(tmp_path):
    file = readings(tmp_path / "a.csv", x=[60, 72, 60, 73], y=[60, 60, 60, 60])
    target = kind("a", file)
    given = {"offset_box": {"y": -0.3}, "size_box": {"w": 0.5, "h": 0.3}, "sd_px": {"x": 3, "y": 2}}
    target["nodes"]["k"] = {
        "parent": "a",
        "fuse": {"latent": {"given": given}},
        "motion": {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
    }
    target["nodes"]["e"] = {"parent": "k", "agent": "intensity"}
    tracker = Tracker(load_graph({"bayesnet": 1, "name": "m", "targets": {"a": target}}))
    tracker.init(BLANK, (50, 50, 20, 20))
    for _ in range(3):
        tracker.update(BLANK)
    line = tracker.targets[0]
    assert line.modes["jumpy"] > 0.5 and "k" in line.parts
    assert abs(line.parts["k"].centre_box[0] - line.centre_box[0]) < 12


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"occlusion": {}}, "a join of a, which a mode can hide: a hidden target has no pixels to share"),
        (
            {"attachment": {}, "between": ["a", "b"]},
            "attachment of a, whose node a has modes: being carried is",
        ),
    ],
)
def test_joins_that_stay_refused_say_why(tmp_path, change, said):
    file = readings(tmp_path / "a.csv", x=[60])
    kinds = {name: kind(name, file) for name in "ab"}
    hidden = {**MODES, "behind": {"mean_frames": 3, "hidden": {}}}
    kinds["a"]["nodes"]["a"]["modes"] = hidden
    graph = {"bayesnet": 1, "name": "g", "targets": kinds, "joins": [{"between": ["a"], **change}]}
    with pytest.raises(GraphError) as error:
        load_graph(graph)
    assert said in str(error.value)
