"""Every meaningful pair of features runs five frames, or is refused with a sentence that stands here."""

from __future__ import annotations

import copy
from itertools import combinations
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Start, load_graph, track
from bayesnet_track.graph.text.explain import describe_error
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.runtime.recording.beliefs import check_kept

BELIEFS = ("gaussian", "grid", "particles that grow", "second pass")
FEATURES = {
    "gaussian": {"belief": {"gaussian": {}}},
    "grid": {"belief": {"grid": {}}},
    "particles that grow": {
        "belief": {"particles": {"size": {"kld_revised": {"bin_px": 5}}, "min": 200, "max": 600}}
    },
    "second pass": {"belief": {"particles": {"size": 200, "proposal": "second_pass"}}},
    "expressions": {
        "motion": {
            "expressions": {
                "fields": {"vx": {"sd": 3}, "vy": {"sd": 3}},
                "drift": {"x": "x + vx * dt", "y": "y + vy * dt"},
                "sd": {"x": 1, "y": 1, "vx": 1, "vy": 1},
            }
        }
    },
    "modes": {
        "modes": {
            "a": {"mean_frames": 20},
            "b": {"mean_frames": 5, "motion": {"constant_velocity": {"sd_velocity_px": 5}}},
        }
    },
    "hidden mode": {"modes": {"a": {"mean_frames": 20}, "b": {"mean_frames": 5, "hidden": {}}}},
    "occlusion": {"joins": [{"between": ["p"], "occlusion": {}}]},
    "factor of two": {
        "joins": [{"between": ["p", "p"], "factor": "normal(a.x - b.x, 40, 5)", "when": {"overlap": 0}}]
    },
    "part": {
        "part": {"offset_box": {"y": -0.3}, "size_box": {"w": 0.5, "h": 0.3}, "sd_px": {"x": 3, "y": 2}}
    },
    "part that moves": {
        "part": {"offset_box": {"y": -0.3}, "size_box": {"w": 0.5, "h": 0.3}, "sd_px": {"x": 3, "y": 2}},
        "part_motion": {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
    },
    "part by expressions": {"part": {"x": "normal(parent.x, 3)", "y": "normal(parent.y - 10, 2)"}},
    "birth": {"birth": {"detector": "background"}},
    "existence": {"birth": {"detector": "detections"}, "existence": {}, "agent": "detection"},
    "relocalize": {"moving": {"relocalize": {"share": 0.1}}},
    "camera": {"moving": {"camera": "compensate"}},
    "reflect": {"moving": {"borders": "reflect"}},
    "readings": {"readings": True},
    "factor": {"factor": "normal(h, 0.3 * y, 8)"},
    "learned pool": {"pool": True},
    "on call": {"adapt": {"agents": ["d"], "on_call": {"every": 4, "above": {"ud_box": 0.1}}}},
    "kept beliefs": {"keep": True},
}
MEANINGLESS = {
    *map(frozenset, combinations(BELIEFS, 2)),
    *map(frozenset, combinations(("part", "part that moves", "part by expressions"), 2)),
    frozenset({"modes", "hidden mode"}),
    frozenset({"occlusion", "factor of two"}),
    frozenset({"birth", "existence"}),
}
JOINED = "a join of p, whose node p holds a {} belief; allowed: kinds whose root has belief: particles"
NO_CELLS = "modes beside a grid, which has no cells for them; allowed: particles or gaussian"
ONE_WAY = "modes beside proposal: second_pass, which knows one way to move; allowed: proposal: bootstrap"
REFUSED = {
    ("gaussian", "occlusion"): JOINED.format("gaussian"),
    (
        "gaussian",
        "part that moves",
    ): "belief: gaussian, and 'k' has a motion of its own; allowed: belief: part",
    ("gaussian", "relocalize"): "relocalize beside gaussian without lost: only a target that can be lost is",
    ("grid", "modes"): NO_CELLS,
    ("grid", "hidden mode"): NO_CELLS,
    ("grid", "occlusion"): JOINED.format("grid"),
    ("grid", "factor of two"): JOINED.format("grid"),
    ("grid", "part that moves"): "belief: grid, and 'k' has a motion of its own; allowed: belief: particles",
    ("grid", "relocalize"): "relocalize beside grid, which cannot jump; allowed: particles or gaussian",
    ("grid", "camera"): "camera beside a grid, whose cells all move alike; allowed: particles or gaussian",
    ("grid", "reflect"): "borders: reflect beside a grid, whose cells all move alike; allowed: particles or",
    (
        "particles that grow",
        "relocalize",
    ): "relocalize beside an adaptive size; allowed: a size that is a number",
    ("second pass", "modes"): ONE_WAY,
    ("second pass", "hidden mode"): ONE_WAY,
    (
        "second pass",
        "part that moves",
    ): "proposal: second_pass, and 'k' has a motion of its own; allowed: prop",
    ("second pass", "relocalize"): "relocalize beside proposal: second_pass; allowed: proposal: bootstrap",
    ("second pass", "reflect"): "borders: reflect beside proposal: second_pass; allowed: proposal: bootstrap",
    ("expressions", "relocalize"): "relocalize changes the drift or the noise of the motions that",
    ("expressions", "camera"): "camera changes the drift or the noise of the motions that are",
    (
        "hidden mode",
        "occlusion",
    ): "a join of p, which a mode can hide: a hidden target has no pixels to share",
}
PAIRS = [pair for pair in combinations(FEATURES, 2) if frozenset(pair) not in MEANINGLESS]


def graph_of(names, folder):
    chosen = {}
    for name in names:
        for key, value in copy.deepcopy(FEATURES[name]).items():
            chosen[key] = {**chosen[key], **value} if isinstance(chosen.get(key), dict) else value
    motion = chosen.get("motion", {"constant_velocity": {"sd_velocity_px": 1}})
    for settings in motion.values():
        settings.update(chosen.get("moving", {}))
    root = {
        "belief": chosen.get("belief", {"particles": {"size": 200}}),
        "motion": motion,
        "fuse": "product",
        **{key: chosen[key] for key in ("modes", "adapt") if key in chosen},
    }
    nodes = {
        "p": root,
        "c": {"parent": "p", "agent": "color_histogram"},
        "d": {"parent": "p", "agent": "intensity"},
    }
    if "part" in chosen:
        nodes["k"] = {"parent": "p", "fuse": {"latent": {"given": chosen["part"]}}}
        nodes["k"] |= {"motion": chosen["part_motion"]} if "part_motion" in chosen else {}
        nodes["e"] = {"parent": "k", "agent": "texture"}
    if "agent" in chosen:
        nodes["s"] = {"parent": "p", "agent": chosen["agent"]}
    if "readings" in chosen:
        file = folder / "r.csv"
        file.write_text("frame,r\n1,110\n3,112\n", encoding="utf-8")
        agent = {"readings": {"file": str(file), "sd": {"r": 5}}}
        nodes["r"] = {"parent": "p", "agent": agent, "measures": {"r": "hypot(x, y)"}}
    if "factor" in chosen:
        nodes["f"] = {"parent": "p", "factor": chosen["factor"]}
    if "pool" in chosen:
        nodes["q"] = {"parent": "p", "fuse": {"pool": "learned"}, "correlation": 0.5}
        nodes["q1"] = {"parent": "q", "agent": "foreground_color"}
        nodes["q2"] = {"parent": "q", "agent": "color_kernel_histogram"}
    target = {**{key: chosen[key] for key in ("birth", "existence") if key in chosen}, "nodes": nodes}
    graph = {"bayesnet": 1, "name": "pair", "targets": {"p": target}}
    return graph | ({"joins": chosen["joins"]} if "joins" in chosen else {}), "keep" in chosen


def frames(rng):
    """A bright square that moves over a dark ground with noise."""
    for number in range(5):
        frame = rng.integers(20, 50, (120, 160, 3), dtype=np.uint8)
        frame[50:74, 60 + 3 * number : 84 + 3 * number] = (40, 200, 220)
        yield frame, (60.0 + 3 * number, 50.0, 24.0, 24.0)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number, (frame, _) in enumerate(frames(np.random.default_rng(3))):
        assert cv2.imwrite(str(folder / f"{number}.png"), frame)
    return str(folder)


def run(graph, images):
    """Five frames through the front door; the targets at the end, of joins two."""
    if "existence" in graph.spec.targets["p"].model_fields_set:
        tracker = DetectionsTracker(graph, size=(160, 120), seed=1)
        for frame, (x, y, w, h) in frames(np.random.default_rng(3)):
            boxes = np.array([[x, y, x + w, y + h], [x + 50, y, x + w + 50, y + h]])
            tracker.update(SimpleNamespace(xyxy=boxes, confidence=np.array([0.9, 0.9])), frame=frame)
        return tracker.targets
    starts = [Start((60, 50, 24, 24), "p")] + [Start((100, 50, 24, 24), "p")] * bool(graph.spec.joins)
    return list(track(graph, images, starts, seed=1))[-1].targets


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::bayesnet_track.sources.entrances.notices.InputNotice")
@pytest.mark.parametrize("pair", PAIRS, ids=" and ".join)
def test_a_pair_runs_or_is_refused_with_a_sentence(pair, tmp_path, images):
    source, keep = graph_of(pair, tmp_path)
    said = REFUSED.get(pair)
    try:
        graph = load_graph(source)
        if keep:
            check_kept(graph.spec)
    except (GraphError, ValueError) as error:
        text = describe_error(error) if isinstance(error, GraphError) else str(error)
        assert said is not None and said in text, error
        return
    assert said is None, "it is accepted: no refusal any more"
    targets = run(graph, images)
    assert all(np.isfinite(one.centre_box).all() for one in targets)
    assert targets or "birth" in source["targets"]["p"]


def test_the_list_of_refusals_names_pairs_that_are_tried():
    assert set(REFUSED) <= set(PAIRS) and len(PAIRS) > 180
