"""Errors of cameras and detections that last, against the joint Gaussian of all targets in NumPy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from tests.engine.street import (
    CAMERA,
    FPS,
    HEIGHT,
    NOISE,
    SIZE_SD,
    SPEED_SD,
    START_SD,
    WIDTH,
    boxes_of,
    detections_of,
    noisy,
    write_camera,
)

BIAS, BIAS_S = 4.0, 50.0
SLOW, SLOW_S = 0.02, 1.5
NAMES = ("x_m", "y_m", "w_m", "h_m", "vx", "vy")


def write_graph(folder, bias=None, seen=None, associate="assignment", **existence):
    write_camera(folder, CAMERA)
    sizes = {"width": dict(zip(("mean", "sd"), WIDTH, strict=True))}
    sizes["height"] = dict(zip(("mean", "sd"), HEIGHT, strict=True))
    moves = {"sd_velocity": SPEED_SD, "start_velocity_sd": START_SD, "sd": {"w": SIZE_SD, "h": SIZE_SD}}
    source = {"calibration": "north.json"} | ({} if bias is None else {"bias_px": bias})
    graph = {
        "bayesnet": 1,
        "name": "street",
        "cameras": {"north": source},
        "targets": {
            "person": {
                "state": {"ground": sizes},
                "associate": associate,
                "existence": {"detection": 0.95, "clutter": 0.01, "births": 0.05, **existence},
                "birth": {"detector": "detections"},
                "nodes": {
                    "person": {
                        "belief": {
                            "gaussian": {"filter": "extended", "likelihood": "sigma_points", "gate": 1}
                        },
                        "motion": {"constant_velocity": moves},
                        "estimate": "mean",
                    },
                    "view": {"parent": "person", "camera": "north"},
                    "seen": {
                        "parent": "view",
                        "agent": {"detection": {"sd_place": NOISE, "sd_size": NOISE, **(seen or {})}},
                    },
                },
            }
        },
    }
    path = folder / "street.yaml"
    path.write_text(json.dumps(graph))
    return path


# ---------------------------------------------------------------- the joint Gaussian


class Joint:
    """T targets of 6 + 4 fields (slow errors last) and one bias (2,) of all: one stacked Gaussian.

    The bias is allowed for: the rows of every gain that are its own are 0 (Schmidt, 1966).
    """

    def __init__(self, boxes, slow_sds):
        self.count, self.slow = len(boxes), np.array(slow_sds)
        size = 10 * self.count + 2
        self.mean, self.covariance = np.zeros(size), np.zeros((size, size))
        self.covariance[-2:, -2:] = BIAS**2 * np.eye(2)
        for k, box in enumerate(boxes):
            self._start(k, box)
        # Two targets that start share the bias: cov(x_i, x_j) = A_i B A_j', A = cov(x, b) B^-1.
        for i in range(self.count):
            for j in range(self.count):
                if i != j:
                    own, other = (self.covariance[10 * k : 10 * k + 10, -2:] for k in (i, j))
                    self.covariance[10 * i : 10 * i + 10, 10 * j : 10 * j + 10] = own @ other.T / BIAS**2

    def _start(self, k, box):
        shared = np.eye(4)[:, :2]
        slow = np.diag(box[[2, 3, 2, 3]])
        error = np.diag((NOISE * box[[2, 3, 2, 3]]) ** 2)
        error = error + BIAS**2 * shared @ shared.T + slow @ np.diag(self.slow**2) @ slow.T
        prior = np.diag([0.0, 0.0, WIDTH[1] ** -2, HEIGHT[1] ** -2])
        usual = np.array([0.0, 0.0, WIDTH[0], HEIGHT[0]])
        foot = CAMERA.ground_points(np.array([[box[0], box[1] + box[3] / 2]]))[0]
        state = np.array([*foot, *usual[2:]])
        for _ in range(50):
            slopes = CAMERA.jacobian(state[None])[0]
            weighted = slopes.T @ np.linalg.inv(error)
            information = weighted @ slopes + prior
            pull = weighted @ (box - CAMERA.boxes(state[None])[0]) + prior @ (usual - state)
            state = state + np.linalg.solve(information, pull)
        gain = np.linalg.solve(information, weighted)
        own = slice(10 * k, 10 * k + 10)
        self.mean[own][:4] = state
        covariance = np.zeros((10, 10))
        covariance[:4, :4] = np.linalg.inv(information)
        covariance[4:6, 4:6] = START_SD**2 * np.eye(2)
        covariance[6:, 6:] = np.diag(self.slow**2)
        covariance[:4, 6:] = -gain @ slow @ np.diag(self.slow**2)
        covariance[6:, :4] = covariance[:4, 6:].T
        self.covariance[own, own] = covariance
        self.covariance[10 * k : 10 * k + 4, -2:] = -gain @ shared * BIAS**2
        self.covariance[-2:, 10 * k : 10 * k + 4] = self.covariance[10 * k : 10 * k + 4, -2:].T

    def predict(self, dt):
        ahead, noise = np.eye(len(self.mean)), np.zeros_like(self.covariance)
        chain = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        for first in range(0, 10 * self.count, 10):
            for k in (first, first + 1):
                ahead[k, k + 4] = dt
                noise[np.ix_([k, k + 4], [k, k + 4])] = SPEED_SD**2 * chain
                noise[k + 2, k + 2] = SIZE_SD**2 * dt
            kept = np.exp(-dt / SLOW_S)
            own = np.arange(first + 6, first + 10)
            ahead[own, own] = kept
            noise[own, own] = self.slow**2 * (1 - kept**2)
        kept = np.exp(-dt / BIAS_S)
        ahead[[-2, -1], [-2, -1]] = kept
        noise[[-2, -1], [-2, -1]] = BIAS**2 * (1 - kept**2)
        self.mean = ahead @ self.mean
        self.covariance = ahead @ self.covariance @ ahead.T + noise

    def update(self, boxes):
        slopes, away, errors = [], [], []
        for k, box in enumerate(boxes):
            state = self.mean[10 * k : 10 * k + 10]
            plain = CAMERA.boxes(state[None, :4])[0]
            h = np.zeros((4, len(self.mean)))
            sides = plain[[2, 3, 2, 3]]
            # Sides are those of the state times 1 + w, 1 + h; places are off by x, y of sides.
            h[:, 10 * k : 10 * k + 4] = CAMERA.jacobian(state[None, :4])[0]
            h[0, 10 * k : 10 * k + 4] += state[6] * h[2, 10 * k : 10 * k + 4]
            h[1, 10 * k : 10 * k + 4] += state[7] * h[3, 10 * k : 10 * k + 4]
            h[2, 10 * k : 10 * k + 4] *= 1 + state[8]
            h[3, 10 * k : 10 * k + 4] *= 1 + state[9]
            h[:, 10 * k + 6 : 10 * k + 10] = np.diag(sides)
            h[:2, -2:] = np.eye(2)
            slopes.append(h)
            away.append(box - plain - sides * state[6:])
            errors.append((NOISE * (plain + sides * state[6:])[[2, 3, 2, 3]]) ** 2)
        # A target is updated by its own detection: other rows of its gain are 0, those of the bias too.
        gain = np.zeros((len(self.mean), 4 * len(boxes)))
        for k, (own, error) in enumerate(zip(slopes, errors, strict=True)):
            rows = slice(10 * k, 10 * k + 10)
            spread = own @ self.covariance @ own.T + np.diag(error)
            gain[rows, 4 * k : 4 * k + 4] = self.covariance[rows] @ own.T @ np.linalg.inv(spread)
        h, away = np.concatenate(slopes), np.concatenate(away)
        noise = np.diag(np.concatenate(errors))
        left = np.eye(len(self.mean)) - gain @ h
        self.mean = self.mean + gain @ away
        self.covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T  # Joseph's form

    def of(self, k):
        own = slice(10 * k, 10 * k + 6)
        return self.mean[own], np.sqrt(np.diag(self.covariance)[own])


def test_targets_are_as_in_the_joint_gaussian_of_camera_and_targets(tmp_path):
    """Schmidt's update of the stack, Joseph's form, has the tracker's targets as its marginals."""
    path = write_graph(
        tmp_path,
        {"sd": 1e-4, "sd_by_place": BIAS, "over_s": BIAS_S},
        {"sd_place_slow": SLOW, "sd_size_slow": SLOW, "slow_over_s": SLOW_S},
    )
    times, rng = np.arange(50)[:, None] / FPS, np.random.default_rng(3)
    ways = [np.array([-3.0, 9.0]) + times * (1.4, 0.4), np.array([4.0, 16.0]) + times * (-0.2, 0.3)]
    boxes = np.stack([noisy(boxes_of(way), rng) for way in ways], axis=1)
    tracker, joint = DetectionsTracker(path, fps=FPS), Joint(boxes[0], [SLOW] * 4)
    compared = 0
    for frame, pair in enumerate(boxes):
        if frame:
            joint.predict(1 / FPS)
            joint.update(pair)
        found = tracker.update(detections_of(pair))
        owners = {str(owner): k for k, owner in enumerate(found.tracker_id.tolist())}
        for target in tracker.targets:
            k = owners[target.target]
            mean, sds = joint.of(k)
            np.testing.assert_allclose([target.state[name] for name in NAMES], mean, atol=1e-5)
            np.testing.assert_allclose([target.state[f"{name}_sd"] for name in NAMES], sds, rtol=1e-4)
            np.testing.assert_allclose(target.state["seen.x"], joint.mean[10 * k + 6], atol=1e-6)
            assert target.state["view.x_by_place_sd"] == pytest.approx(BIAS)
            compared += 1
    assert compared > 80
    between = joint.covariance[:2, 10:12]  # targets of one camera are off together
    assert np.linalg.svd(between, compute_uv=False)[0] > 1e-3


@pytest.mark.slow
def test_a_standing_target_stays_as_uncertain_as_its_camera(tmp_path):
    """The sd of the foot point along x cannot fall below that of the bias, for however long it stands."""
    (box,) = boxes_of(np.array([[0.5, 10.0]]))
    rng, sds = np.random.default_rng(0), {}
    for bias in (None, {"sd": BIAS}):
        tracker = DetectionsTracker(write_graph(tmp_path, bias, associate="marginal"), fps=FPS)
        for _ in range(60):
            tracker.update(detections_of(noisy(box[None], rng)))
        (target,) = tracker.targets
        sds[bias is None] = target.state["x_m_sd"]
    metres = BIAS / CAMERA.jacobian(np.array([[0.5, 10.0, *WIDTH[:1], *HEIGHT[:1]]]))[0][0, 0]
    assert sds[False] > 0.95 * metres
    assert sds[False] ** 2 == pytest.approx(sds[True] ** 2 + metres**2, rel=0.15)


def test_the_cut_edge_of_a_box_is_no_measurement(tmp_path):
    """Somebody stands so near that the image ends at the knees: the place is where the head says."""
    place = np.array([0.0, 4.8])
    (box,) = boxes_of(place[None])
    low, high = box[1] - box[3] / 2, box[1] + box[3] / 2
    assert high > 479.5 + 20  # the feet are below the image
    cut = box.copy()
    cut[1], cut[3] = (low + 479.5) / 2, 479.5 - low
    tracker = DetectionsTracker(write_graph(tmp_path, associate="marginal"), fps=FPS)
    rng = np.random.default_rng(0)
    for _ in range(30):
        seen = noisy(cut[None], rng)
        top = seen[0, 1] - seen[0, 3] / 2
        seen[0, 1], seen[0, 3] = (top + 479.5) / 2, 479.5 - top
        tracker.update(detections_of(seen))
    (target,) = tracker.targets
    state = target.state
    away = np.array([state["x_m"], state["y_m"]]) - place
    sds = np.array([state["x_m_sd"], state["y_m_sd"]])
    assert (np.abs(away) < 3.0 * sds).all(), (away, sds)
    assert np.abs(away[1]) < 0.6
    assert sds[1] > 0.1  # as uncertain as the height, 0.1 m, leaves it
