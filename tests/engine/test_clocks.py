"""Clocks and biases of cameras, learnt from all targets: against their joint Gaussian in NumPy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.journal.events.cameras import ClockLearnt
from tests.engine.test_several_cameras import (
    CAMERAS,
    FPS,
    NOISE,
    SIZE_SD,
    boxes_of,
    detections_of,
    noisy,
    walk,
    write_graph,
)

OFFSET, SD, RATE, SPEED_SD = 0.2, 0.2, 1e-3, 0.2
WALKS = [((-2.0, 9.0), (0.9, 0.3)), ((0.0, 12.0), (0.7, -0.3)), ((-3.0, 11.5), (0.2, 0.8))]
CLOCKS = {
    "without a rate": {"offset_s": {"sd": SD}},
    "with a rate": {"offset_s": {"sd": SD}, "rate": {"sd": RATE}},
}
BIAS, BIAS_S = 3.0, 3600.0
BIASES = {"south": (3.0, -2.0), "east": (-2.0, 4.0)}


def graph_with(folder, clock, cameras=("south", "east"), bias=None, **existence):
    path = write_graph(folder, cameras, **existence)
    graph = json.loads(path.read_text())
    if bias is not None:
        graph["cameras"] = {name: source | {"bias_px": bias} for name, source in graph["cameras"].items()}
    if clock is not None:
        graph["cameras"][cameras[1]]["clock"] = clock
    motion = graph["targets"]["person"]["nodes"]["person"]["motion"]["constant_velocity"]
    motion["sd_velocity"] = SPEED_SD
    path.write_text(json.dumps(graph))
    return path


def places_at(time_s):
    return np.array([np.array(start) + time_s * np.array(velocity) for start, velocity in WALKS])


def steps(rng, count, alternate=False, offset=OFFSET, drift=0.0):
    """Time and camera -> boxes of each target; `east` is late."""
    for frame in range(count):
        time_s, late = frame / FPS, offset + drift * frame / FPS
        cameras = ("south", "east") if not alternate else (("south", "east")[frame % 2],)
        at = {"south": time_s, "east": time_s - late}
        yield time_s, {name: noisy(boxes_of(name, places_at(at[name])), rng) for name in cameras}


class Joint:
    """Targets of 6 fields, then what they share, by name: one Gaussian, updated by all at once."""

    def __init__(self, beliefs, names):
        self.count, self.names, extra = len(beliefs), names, len(names)
        self.extra = extra
        size, width = 6 * self.count + extra, 6 + extra
        self.mean, self.covariance = np.zeros(size), np.zeros((size, size))
        clock = np.arange(size - extra, size)
        parts = []
        for k, (mean, covariance) in enumerate(beliefs):
            own = np.r_[6 * k : 6 * k + 6, clock]
            self.mean[own] = mean
            self.covariance[np.ix_(own, own)] = covariance
            gain = np.linalg.solve(covariance[6:width, 6:width], covariance[:6, 6:width].T).T
            parts.append((own[:6], gain, covariance[6:width, 6:width]))
        for i, (own, gain, spread) in enumerate(parts):  # targets depend on each other by the clock alone
            for j, (other, with_gain, _) in enumerate(parts):
                if i != j:
                    self.covariance[np.ix_(own, other)] = gain @ spread @ with_gain.T

    def place(self, name):
        return 6 * self.count + self.names.index(name) if name in self.names else None

    def predict(self, dt):
        ahead, noise = np.eye(len(self.mean)), np.zeros_like(self.covariance)
        chain = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        for k in [first + axis for first in range(0, 6 * self.count, 6) for axis in (0, 1)]:
            ahead[k, k + 4] = dt
            noise[np.ix_([k, k + 4], [k, k + 4])] = SPEED_SD**2 * chain
            noise[k + 2, k + 2] = SIZE_SD**2 * dt
        for k, name in enumerate(self.names, 6 * self.count):
            if name.endswith((".x", ".y")):
                ahead[k, k] = np.exp(-dt / BIAS_S)
                noise[k, k] = BIAS**2 * (1 - np.exp(-2 * dt / BIAS_S))
            elif name.endswith("rate"):
                ahead[k - 1, k] = dt
        self.mean = ahead @ self.mean
        self.covariance = ahead @ self.covariance @ ahead.T + noise

    def update(self, camera, boxes):
        """By the derivative of h(x - o v), and what it leaves out: Cov(o, v), P_oo P_vv + .., q |o|^3 / 3."""
        late, clock = camera == "east", self.place("view.east.clock_s")
        late = late and clock is not None
        offset, variance = (self.mean[clock], self.covariance[clock, clock]) if late else (0.0, 0.0)
        biases = [place for axis in "xy" if (place := self.place(f"view.{camera}.{axis}")) is not None]
        slopes, away, noise = [], [], np.zeros((4 * self.count, 4 * self.count))
        for k, box in enumerate(boxes):
            own, speed = slice(6 * k, 6 * k + 4), slice(6 * k + 4, 6 * k + 6)
            state = self.mean[own].copy()
            both = self.covariance[speed, clock] if late else np.zeros(2)
            state[:2] -= offset * self.mean[speed]
            h = np.zeros((4, len(self.mean)))
            h[:, own] = CAMERAS[camera].jacobian(state[None])[0]
            h[:, speed] = -offset * h[:, own][:, :2]
            if late:
                h[:, clock] = -h[:, own][:, :2] @ self.mean[speed]
            h[range(len(biases)), biases] = 1.0
            state_shifted = state.copy()
            state_shifted[:2] -= both
            ground = CAMERAS[camera].jacobian(state_shifted[None])[0][:, :2]
            since = SPEED_SD**2 * (offset**2 + variance) ** 1.5 / 3
            spread = variance * self.covariance[speed, speed] + np.outer(both, both) + since * np.eye(2)
            block = slice(4 * k, 4 * k + 4)
            expected = CAMERAS[camera].boxes(state[None])[0]
            expected[: len(biases)] += self.mean[biases]
            noise[block, block] = np.diag((NOISE * expected[[2, 3, 2, 3]]) ** 2) + ground @ spread @ ground.T
            slopes.append(h)
            away.append(box - expected + ground @ both)
        h, away = np.concatenate(slopes), np.concatenate(away)
        gain = self.covariance @ h.T @ np.linalg.inv(h @ self.covariance @ h.T + noise)
        self.mean, self.covariance = self.mean + gain @ away, self.covariance - gain @ h @ self.covariance


@pytest.mark.parametrize("bias", [None, {"sd": BIAS}], ids=["exact", "biased"])
@pytest.mark.parametrize("clock", CLOCKS.values(), ids=[*CLOCKS])
def test_errors_and_targets_are_as_in_the_joint_gaussian(tmp_path, clock, bias):
    """Every frame's evidence counts once, for each camera and target: to rounding, one camera a step."""
    tracker, rng = (
        DetectionsTracker(graph_with(tmp_path, clock, bias=bias), fps=FPS),
        np.random.default_rng(3),
    )
    joint, compared = None, 0
    for time_s, boxes in steps(rng, 40, alternate=True):
        ((camera, own),) = boxes.items()
        own = own + np.array([*BIASES[camera], 0.0, 0.0]) * (bias is not None)
        marked = tracker.update({camera: detections_of(own)}, time_s=time_s)[camera].tracker_id.tolist()
        beliefs = {name: state.belief for name, state in tracker._now.state.targets.items()}
        order = [str(number) for number in marked]
        if joint is not None:
            joint.predict(1 / FPS)
            joint.update(camera, own)
            for k, name in enumerate(order):
                at = np.r_[6 * k : 6 * k + 6, len(joint.mean) - joint.extra : len(joint.mean)]
                np.testing.assert_allclose(beliefs[name].mean, joint.mean[at], atol=1e-4)
                expected = joint.covariance[np.ix_(at, at)]
                sds = np.sqrt(np.diag(expected))
                np.testing.assert_allclose(
                    beliefs[name].covariance / np.outer(sds, sds), expected / np.outer(sds, sds), atol=2e-4
                )
                compared += 1
        elif time_s > 1.45:  # all have started, and surely move
            names = list(beliefs[order[0]].fields[6:])
            joint = Joint([(beliefs[name].mean, beliefs[name].covariance) for name in order], names)
    assert compared == 72
    for name, true in {"view.east.clock_s": OFFSET, "view.south.x": BIASES["south"][0]}.items():
        if (at := joint.place(name)) is not None:
            assert abs(joint.mean[at] - true) < 4.0 * np.sqrt(joint.covariance[at, at])


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.3, -0.15])
def test_the_offset_is_learnt_and_said(tmp_path, offset):
    tracker, rng = (
        DetectionsTracker(graph_with(tmp_path, {"offset_s": {"sd": SD}}), fps=FPS),
        np.random.default_rng(5),
    )
    said = []
    for time_s, boxes in steps(rng, 35, offset=offset):
        tracker.update({camera: detections_of(one) for camera, one in boxes.items()}, time_s=time_s)
        said += [event for event in tracker.events if isinstance(event, ClockLearnt)]
    state = tracker.targets[0].state
    assert state["view.east.clock_s"] == pytest.approx(offset, abs=0.03)
    assert abs(state["view.east.clock_s"] - offset) < 2.5 * state["view.east.clock_s_sd"]
    assert [event.camera for event in said] == ["east"] * len(said)
    assert said[-1].offset_s == pytest.approx(offset, abs=0.05)
    assert said[-1].sd_s < said[0].sd_s <= 0.5 * SD
    way = "late" if offset > 0 else "early"
    assert f" s {way} (before " in said[-1].describe()


@pytest.mark.slow
def test_people_stay_one_each_where_a_camera_is_half_a_second_late(tmp_path):
    """Taken for right, the late camera starts people of its own, 0.4 m behind; learnt, none."""
    numbers = {}
    for clock in (None, {"offset_s": {"sd": 0.5}}):
        path, rng = graph_with(tmp_path, clock), np.random.default_rng(7)
        tracker = DetectionsTracker(path, fps=FPS)
        for time_s, boxes in steps(rng, 20, offset=0.5):
            given = {camera: detections_of(one) for camera, one in boxes.items()}
            marked = tracker.update(given, time_s=time_s)
        numbers[clock is None] = [marked[camera].tracker_id.tolist() for camera in ("south", "east")]
    assert numbers[False][0] == numbers[False][1]
    assert sorted(numbers[False][0]) == [1, 2, 3]
    assert numbers[True][0] != numbers[True][1]


def test_a_clock_says_nothing_of_what_stands(tmp_path):
    tracker, rng = (
        DetectionsTracker(graph_with(tmp_path, {"offset_s": {"sd": SD}}), fps=FPS),
        np.random.default_rng(8),
    )
    for frame in range(30):
        given = {name: detections_of(noisy(boxes_of(name, (0.5, 10.0)), rng)) for name in ("south", "east")}
        tracker.update(given, time_s=frame / FPS)
    (target,) = tracker.targets
    assert target.state["view.east.clock_s_sd"] > 0.9 * SD
    assert abs(target.state["view.east.clock_s"]) < 0.3 * SD


@pytest.mark.slow
def test_a_start_by_a_late_camera_stands_where_it_is_now(tmp_path):
    """Once the clock is known, who comes in by the late camera alone starts by its offset further on."""
    tracker, rng = (
        DetectionsTracker(graph_with(tmp_path, {"offset_s": {"sd": SD}}), fps=FPS),
        np.random.default_rng(9),
    )
    for time_s, boxes in steps(rng, 25, offset=0.3):
        tracker.update({camera: detections_of(one) for camera, one in boxes.items()}, time_s=time_s)
    before = {target.target for target in tracker.targets}
    way = walk(30, (6.0, 6.0), (0.0, 1.2))
    for frame in range(25, 45):
        at = way[frame - 25] - 0.3 * np.array([0.0, 1.2])
        marked = tracker.update({"east": detections_of(noisy(boxes_of("east", at), rng))}, time_s=frame / FPS)
    (new,) = [one for one in tracker.targets if one.target not in before]
    assert marked["east"].tracker_id.tolist() == [int(new.target)]
    assert abs(new.state["y_m"] - way[19][1]) < 2.5 * new.state["y_m_sd"]
    assert abs(new.state["y_m"] - (way[19][1] - 0.36)) > abs(new.state["y_m"] - way[19][1])


@pytest.mark.slow
def test_clocks_are_stored_with_the_state(tmp_path):
    """A tracker that is saved and loaded between two steps learns on as one that went on."""
    path, rng = graph_with(tmp_path, {"offset_s": {"sd": SD}}), np.random.default_rng(3)
    tracker, seen = DetectionsTracker(path, fps=FPS), list(steps(rng, 16))
    seen = [(when, {camera: detections_of(one) for camera, one in boxes.items()}) for when, boxes in seen]
    for time_s, given in seen[:10]:
        tracker.update(given, time_s=time_s)
    tracker.save(tmp_path / "state.bin")
    loaded = DetectionsTracker.load(tmp_path / "state.bin")
    for time_s, given in seen[10:]:
        for one in (tracker, loaded):
            one.update(given, time_s=time_s)
    assert len(tracker.targets) == len(WALKS)
    for one, other in zip(tracker.targets, loaded.targets, strict=True):
        assert one.centre_box == other.centre_box
