"""Gaussian targets that linear factors relate: one Gaussian of all states, as a Kalman filter has it."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Start, load_graph
from bayesnet_track.belief.gaussian.belief import GaussianFilter
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import first_look, make_engine, step
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.faults import PairFactorChanged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state
from bayesnet_track.runtime.recording.beliefs import UnkeptBeliefError, check_kept

FRAMES = 8
PLACES = {"a": 60.0, "b": 90.0, "c": 115.0}
CV = {"constant_velocity": {"sd_velocity_px": 1}}
WALK = {"random_walk": {"sd_px": {"x": 4, "y": 4}}}
WRITTEN = {
    "expressions": {
        "fields": {"vx": {"sd": 3}},
        "drift": {"x": "x + vx * dt", "vx": "0.9 * vx"},
        "sd": {"x": 1, "y": 2, "vx": 0.5},
    }
}
JOINS = [
    {"between": ["a", "b"], "factor": "normal(b.x - a.x, 30, 2) * normal(a.y, b.y, 1)"},
    {"between": ["b", "c"], "factor": "normal(2 * b.x, 2 * a.x + offset + t, 3)"},
    {"between": ["a", "c"], "factor": "normal(a.x + b.x, 190 + 4 * t, 6)"},
]
"""Two springs and a third factor that closes the ring; a is the first of each pair, b the second."""
FACTORS = {  # rows of (a, b, c) in x or y, what they are, sds
    1: ("x", [-1, 1, 0], lambda t: 30.0, 2.0),
    2: ("y", [1, -1, 0], lambda t: 0.0, 1.0),
    3: ("x", [0, -2, 2], lambda t: 50.0 + t, 3.0),
    4: ("x", [1, 0, 1], lambda t: 190.0 + 4 * t, 6.0),
}


@pytest.fixture
def readings(tmp_path):
    """Target -> its file, and (FRAMES, 2) what it says."""
    files, rng = {}, np.random.default_rng(7)
    for name, x in PLACES.items():
        values = np.stack([x + 2.0 * np.arange(FRAMES), 50.0 + np.arange(FRAMES)], 1)
        values = np.round(values + 3.0 * rng.standard_normal(values.shape), 3)
        lines = [f"{frame},{x},{y}" for frame, (x, y) in enumerate(values.tolist()) if frame]
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join(["frame,x,y", *lines]), encoding="utf-8")
        files[name] = (str(file), values)
    return files


def graph_of(readings, belief, motions, joins=JOINS):
    targets = {}
    for name, motion in motions.items():
        agent = {"readings": {"file": readings[name][0], "sd": {"x": 3, "y": 3}}}
        root = {"belief": belief, "motion": motion, "fuse": "product"}
        targets[name] = {"nodes": {name: root, "s": {"parent": name, "agent": agent}}}
    joins = [{**one, "when": {"overlap": 0}} for one in joins]
    return {"bayesnet": 1, "name": "g", "constants": {"offset": 50}, "targets": targets, "joins": joins}


def run(graph, frames=FRAMES, between=lambda engine, state, frame: state):
    """The outcomes of frames that show nothing."""
    engine, outcomes = make_engine(graph, 1), []
    image = np.full((120, 240, 3), 99, dtype=np.uint8)
    for index in range(frames):
        frame = Frame(index, float(index), image, True, float(index))
        if not outcomes:
            starts = [Start((x - 10.0, 40.0, 20.0, 20.0), name) for name, x in PLACES.items()]
            outcomes.append(first_look(engine, start_targets(graph, engine, frame, starts), frame))
        else:
            state = between(engine, outcomes[-1].state, outcomes[-1].state.previous)
            outcomes.append(step(engine, state, frame))
    return engine, outcomes


def kalman(engine, beliefs, readings):
    """Means and covariances of all states in one Kalman filter that starts with `beliefs`, frame by frame."""
    motions = {name: engine.plates[name].motion for name in PLACES}
    starts = [(belief.mean, belief.covariance) for belief in beliefs]
    widths = [len(mean) for mean, _ in starts]
    ends = np.cumsum(widths)
    places = [slice(end - width, end) for end, width in zip(ends, widths, strict=True)]
    mean, covariance = np.concatenate([mean for mean, _ in starts]), np.zeros((ends[-1], ends[-1]))
    for at, (_, own) in zip(places, starts, strict=True):
        covariance[at, at] = own
    for frame in range(1, FRAMES):
        transition, noise = np.zeros_like(covariance), np.zeros_like(covariance)
        for at, motion in zip(places, motions.values(), strict=True):
            transition[at, at], noise[at, at] = motion.linearise(mean[at], 1.0)
        moved = [
            motion.drift(mean[at][None], 1.0)[0] for at, motion in zip(places, motions.values(), strict=True)
        ]
        mean, covariance = np.concatenate(moved), transition @ covariance @ transition.T + noise
        rows, wanted, variances = [], [], []
        for at, (_, values) in zip(places, readings.values(), strict=True):
            for axis in (0, 1):
                rows.append(np.eye(len(mean))[at.start + axis])
                wanted.append(values[frame, axis])
                variances.append(9.0)
        for axis, factors, value, sd in FACTORS.values():
            row = np.zeros(len(mean))
            for at, factor in zip(places, factors, strict=True):
                row[at.start + "xy".index(axis)] = factor
            rows.append(row)
            wanted.append(value(float(frame)))
            variances.append(sd**2)
        observe = np.array(rows)
        gain = covariance @ observe.T @ np.linalg.inv(observe @ covariance @ observe.T + np.diag(variances))
        mean = mean + gain @ (np.array(wanted) - observe @ mean)
        covariance = covariance - gain @ observe @ covariance
        yield [(mean[at], covariance[at, at]) for at in places]


@pytest.mark.parametrize("kind", ["kalman", "extended", "unscented"])
@pytest.mark.parametrize("motions", [(CV, CV, WALK), (CV, WRITTEN, WALK)], ids=["kinematic", "written"])
def test_three_targets_in_a_ring_are_those_of_one_kalman_filter(kind, motions, readings):
    if kind == "kalman" and WRITTEN in motions:
        kind = "extended"
    belief = {"gaussian": {"filter": kind, "gate": 1}}
    graph = load_graph(graph_of(readings, belief, dict(zip("abc", motions, strict=True))))
    engine, outcomes = run(graph)
    alone = run(load_graph(graph_of(readings, belief, dict(zip("abc", motions, strict=True)), [])))[1]
    first = [one.belief for one in outcomes[0].state.targets.values()]
    exact_all = kalman(engine, first, readings)
    for outcome, exact in zip(outcomes[1:], exact_all, strict=True):
        beliefs = [one.belief for one in outcome.state.targets.values()]
        for belief, (mean, covariance) in zip(beliefs, exact, strict=True):
            np.testing.assert_allclose(belief.mean, mean, atol=1e-6)
            np.testing.assert_allclose(belief.covariance, covariance, atol=1e-6)
    last = [[one.belief.mean for one in run_[-1].state.targets.values()] for run_ in (outcomes, alone)]
    assert max(np.abs(joined - by_itself).max() for joined, by_itself in zip(*last, strict=True)) > 0.5


def test_a_state_that_is_stored_goes_on_with_what_relates_its_targets(readings):
    graph = load_graph(
        graph_of(readings, {"gaussian": {"gate": 1}}, dict(zip("abc", (CV, CV, WALK), strict=True)))
    )
    straight = run(graph)[1][-1].state
    stored = run(graph, between=lambda engine, state, frame: decode_state(encode_state(state), engine, frame))
    assert encode_state(stored[1][-1].state) == encode_state(straight)
    assert len(straight.joins.crosses) == 3


def test_a_factor_without_an_sd_is_an_event_and_left_out(readings):
    joins = [{"between": ["a", "b"], "factor": "normal(b.x - a.x, 30, 3 - t)"}]
    motions = dict.fromkeys("abc", CV)
    outcomes = run(load_graph(graph_of(readings, {"gaussian": {"gate": 1}}, motions, joins)))[1]
    flawed = [
        (event.frame, event.describe())
        for outcome in outcomes
        for event in outcome.events
        if isinstance(event, PairFactorChanged)
    ]
    assert [frame for frame, _ in flawed] == [3] and "is left out" in flawed[0][1]


MODES = {
    "slow": {"mean_frames": 9},
    "fast": {"mean_frames": 9, "motion": {"constant_velocity": {"sd_velocity_px": 9}}},
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"factor": "normal(hypot(a.x - b.x, a.y - b.y), 50, 5)"},
         "a factor of gaussian beliefs that is no product of normal densities of linear forms; allowed: such "
         "as normal(a.x - b.x, 40, 5) * normal(a.y - b.y, 0, 5); or belief: particles"),
        ({"factor": "0.1 + normal(a.x - b.x, 50, 5)"}, "that is no product of normal densities"),
        ({"factor": "normal(a.x - b.x, 50, a.w)"}, "that is no product of normal densities"),
        ({"factor": None, "exclusion": {}},
         "a join of a, whose node a holds a gaussian belief; allowed: kinds whose root has belief: "
         "particles; or gaussian beliefs and a factor of linear forms"),
        ({"belief": {"particles": {}}},
         "a join of a, whose node a holds a gaussian belief, with one that does not; allowed: one kind of "
         "belief for both"),
        ({"modes": MODES},
         "whose node b has a gaussian belief and modes; allowed: belief: particles, or no modes"),
        ({"category": {"team": {"values": ["red", "blue"]}}},
         "whose node b has a gaussian belief and a category; allowed: belief: particles, or no category"),
    ],
)  # fmt: skip
def test_what_is_refused_says_what_to_do(change, said, readings):
    source = graph_of(readings, {"gaussian": {}}, dict.fromkeys("abc", CV), JOINS[:1])
    source["joins"][0] |= {key: value for key, value in change.items() if key in ("factor", "exclusion")}
    source["joins"] = [{key: value for key, value in source["joins"][0].items() if value is not None}]
    if "factor" not in source["joins"][0]:
        source["joins"][0]["when"] = {"overlap": 0.1}
    root = source["targets"]["b"]["nodes"]["b"]
    root |= {key: value for key, value in change.items() if key in ("belief", "modes", "category")}
    with pytest.raises(GraphError) as caught:
        load_graph(source)
    assert said in str(caught.value)


def test_beliefs_that_are_joined_are_not_kept(readings):
    graph = load_graph(graph_of(readings, {"gaussian": {}}, dict.fromkeys("abc", CV)))
    with pytest.raises(UnkeptBeliefError, match="is Gaussian and joined with others"):
        check_kept(graph.spec)


def test_a_target_whose_evidence_leaves_nothing_keeps_its_prediction_and_is_related(readings, monkeypatch):
    """Likelihoods that contradict each other in two frames: the spring alone then says where it is."""
    weigh = GaussianFilter._weigh

    def contradicted(self, predicted, points, evidence, motion):
        if abs(predicted[0][0] - 90.0) < 10.0:
            return *predicted, "nothing is left"
        return weigh(self, predicted, points, evidence, motion)

    monkeypatch.setattr(GaussianFilter, "_weigh", contradicted)
    source = graph_of(readings, {"gaussian": {"gate": 1}}, dict.fromkeys("abc", CV), JOINS[:1])
    last = [one.belief for one in run(load_graph(source), 4)[1][-1].state.targets.values()]
    assert last[1].mean[0] - last[0].mean[0] == pytest.approx(30, abs=1.5)
    free = [one.belief for one in run(load_graph(source | {"joins": []}), 4)[1][-1].state.targets.values()]
    assert last[1].covariance[0, 0] < 0.5 * free[1].covariance[0, 0]
