"""Detections of quantities, z = h(x) + N(0, R), against closed forms, enumeration and other people's filters.

The references are NumPy of their own: nothing of them is of the package. Where Stone-Soup is installed its
extended Kalman filter is asked, too.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from bayesnet_track.engine.lifecycle.detecting import scan
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import make_engine, step
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.observation.detector import Scan
from bayesnet_track.observation.planes import Frame

BLACK = np.zeros((16, 16, 3), np.uint8)
RADAR = {
    "parent": "ship",
    "agent": {
        "detection": {
            "sd": {"range": 2.0, "bearing": 0.01},
            "within": {"range": [0, 1000], "bearing": [-math.pi, math.pi]},
            "gate": 1.0,
        }
    },
    "measures": {"range": "hypot(x, y)", "bearing": "atan2(y, x)"},
}
GPS = {
    "parent": "ship",
    "agent": {
        "detection": {"sd": {"x": 3.0, "y": 4.0}, "within": {"x": [-500, 500], "y": [-500, 500]}, "gate": 1.0}
    },
}
SPEED_SD, START_SD, SURVIVAL = 0.5, 5.0, 0.99


def graph(sensors, associate="assignment", filter_="extended", **existence):
    """Independent misses and false detections, so that what is enumerated is all there is."""
    settings = {"detection": 0.9, "clutter": 2.0, "births": 0.1, "survival": SURVIVAL}
    settings |= {"missed_frames": 1, "false_frames": 1, **existence}
    root = {
        "belief": {"gaussian": {"filter": filter_, "likelihood": "sigma_points", "gate": 1}},
        "motion": {"constant_velocity": {"sd_velocity_px": SPEED_SD, "start_velocity_sd_px": START_SD}},
        "estimate": "mean",
    }
    if len(sensors) > 1:
        root["fuse"] = "product"
    plate = {
        "state": "point",
        "associate": associate,
        "existence": settings,
        "birth": {"detector": "detections", "max_targets": 50},
        "merge_duplicates": "never",
        "nodes": {"ship": root, **sensors},
    }
    return load_graph({"name": "sea", "targets": {"ship": plate}})


class Given:
    def __init__(self, looks):
        self.looks = looks

    def scans(self, frame):
        found = self.looks[frame.index]
        return {one: Scan(np.array(z, float).reshape(-1, 2), np.ones(len(z))) for one, z in found.items()}


def outcomes(checked, looks, times=None):
    engine = make_engine(checked, 0, detectors={"detections": Given(looks)})
    done = []
    for index in range(len(looks)):
        time = float(index if times is None else times[index])
        frame = Frame(index=index, time=time, time_s=time, image=BLACK)
        before = done[-1].state if done else None
        done.append(
            start_targets(checked, engine, frame, ()) if before is None else step(engine, before, frame)
        )
    return done


# ---------------------------------------------------------------- references


def move(dt):
    ahead, noise = np.eye(4), np.zeros((4, 4))
    for k in (0, 1):
        ahead[k, k + 2] = dt
        noise[np.ix_([k, k + 2], [k, k + 2])] = SPEED_SD**2 * np.array(
            [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]
        )
    return ahead, noise


def radar(state):
    x, y = state[:2]
    r2 = x * x + y * y
    slopes = np.array([[x / math.sqrt(r2), y / math.sqrt(r2), 0, 0], [-y / r2, x / r2, 0, 0]])
    return np.array([math.sqrt(r2), math.atan2(y, x)]), slopes, np.diag([4.0, 1e-4])


def gps(state):
    return state[:2], np.eye(2, 4), np.diag([9.0, 16.0])


def innovation(z, expected, sensor):
    away = np.array(z) - expected
    if sensor is radar:
        away[1] = math.remainder(away[1], 2 * math.pi)
    return away


def correct(mean, covariance, z, sensor):
    expected, slopes, noise = sensor(mean)
    away = innovation(z, expected, sensor)
    spread = slopes @ covariance @ slopes.T + noise
    gain = covariance @ slopes.T @ np.linalg.inv(spread)
    log = -0.5 * (away @ np.linalg.solve(spread, away) + np.linalg.slogdet(2 * np.pi * spread)[1])
    return mean + gain @ away, covariance - gain @ slopes @ covariance, log


def place(z, sensor):
    """The moments of a target that starts with a detection."""
    mean = np.array([*z, 0, 0], float)
    if sensor is radar:
        mean[:2] = z[0] * math.cos(z[1]), z[0] * math.sin(z[1])
    _, slopes, noise = sensor(mean)
    covariance = np.diag([0, 0, START_SD**2, START_SD**2]).astype(float)
    back = np.linalg.inv(slopes[:, :2])
    covariance[:2, :2] = back @ noise @ back.T
    return mean, covariance


def predicted(mean, covariance, dt):
    ahead, noise = move(dt)
    return ahead @ mean, ahead @ covariance @ ahead.T + noise


COLUMNS = [0, 1, 4, 5]
"""x, y, vx, vy among the fields of a state."""


def moments(belief):
    return belief.mean[COLUMNS], belief.covariance[np.ix_(COLUMNS, COLUMNS)]


def path(count, seed, start=(-120.0, 30.0), speed=(1.5, -2.0)):
    rng = np.random.default_rng(seed)
    at = np.array(start) + np.arange(count)[:, None] * np.array(speed)
    polar = np.stack([np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])], axis=1)
    polar = polar + rng.normal(size=polar.shape) * [2.0, 0.01]
    polar[:, 1] = (polar[:, 1] + np.pi) % (2 * np.pi) - np.pi
    return at, polar, at + rng.normal(size=at.shape) * [3.0, 4.0]


# ---------------------------------------------------------------- one target


@pytest.mark.parametrize("name", ["radar", "gps"])
def test_one_target_is_a_textbook_filter_across_pi_and_over_gaps(name):
    """Bearings run across +-pi; frames come in uneven intervals."""
    times = np.cumsum([0, 1, 1, 2, 0.5, 1, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1])
    _, polar, places = path(len(times), 3)
    sensor, measured, node = (radar, polar, RADAR) if name == "radar" else (gps, places, GPS)
    looks = [{name: [z.tolist()]} for z in measured]
    checked = graph({name: node}, clutter=1e-9, detection=0.999)
    mean, covariance = place(measured[0], sensor)
    done = outcomes(checked, looks, times)
    for k in range(1, len(times)):
        mean, covariance = predicted(mean, covariance, times[k] - times[k - 1])
        mean, covariance, _ = correct(mean, covariance, measured[k], sensor)
        (state,) = done[k].state.targets.values()
        own, spread = moments(state.belief)
        assert own == pytest.approx(mean, abs=2e-6)
        assert spread == pytest.approx(covariance, rel=1e-5, abs=1e-6)
        assert state.belief.mean[2:4].tolist() == [1.0, 1.0]


def test_stone_soup_has_the_same_numbers():
    """Its extended Kalman filter, started with the same moments, on the same measurements."""
    pytest.importorskip("stonesoup")
    from datetime import datetime, timedelta

    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    _, polar, _ = path(20, 5)
    done = outcomes(
        graph({"radar": RADAR}, clutter=1e-9, detection=0.999), [{"radar": [z.tolist()]} for z in polar]
    )
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(SPEED_SD**2)] * 2)
    model = CartesianToBearingRange(4, (0, 2), np.diag([1e-4, 4.0]))
    order = [0, 2, 1, 3]
    mean, covariance = place(polar[0], radar)
    then = datetime(2030, 1, 1)
    now = GaussianState(mean[order].reshape(4, 1), covariance[np.ix_(order, order)], timestamp=then)
    predictor, updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(model)
    for k in range(1, len(polar)):
        moment = then + timedelta(seconds=k)
        seen = Detection(np.array([[polar[k, 1]], [polar[k, 0]]]), timestamp=moment, measurement_model=model)
        ahead = predictor.predict(now, timestamp=moment)
        now = updater.update(SingleHypothesis(ahead, seen))
        (state,) = done[k].state.targets.values()
        own, spread = moments(state.belief)
        assert own == pytest.approx(np.asarray(now.mean, float).ravel()[order], abs=1e-4)
        assert spread == pytest.approx(np.asarray(now.covar, float)[np.ix_(order, order)], rel=1e-3, abs=1e-4)


def test_a_scene_turned_by_half_a_turn_has_the_same_tracks():
    """Nothing depends on where an angle's zero lies."""
    rng = np.random.default_rng(0)
    at = np.array([[-150.0, 8.0], [-160.0, -9.0]])
    runs = []
    for turn in (0.0, np.pi):
        rng = np.random.default_rng(1)
        looks = []
        for k in range(15):
            now = at + k * np.array([[0.5, -1.5], [0.3, 1.2]])
            z = np.stack([np.hypot(*now.T), np.arctan2(now[:, 1], now[:, 0])], 1)
            z = z + rng.normal(size=z.shape) * [2.0, 0.01]
            z[:, 1] = (z[:, 1] + turn + np.pi) % (2 * np.pi) - np.pi
            looks.append({"radar": z.tolist()})
        runs.append(outcomes(graph({"radar": RADAR}, "marginal"), looks))
    for first, second in zip(*runs, strict=True):
        assert first.state.targets.keys() == second.state.targets.keys()
        for target, one in first.state.targets.items():
            other = second.state.targets[target]
            assert one.belief.mean[COLUMNS] == pytest.approx(-other.belief.mean[COLUMNS], abs=1e-5)
            assert one.existence == pytest.approx(other.existence, abs=1e-6)
    assert len(runs[0][-1].state.targets) == 2


# ---------------------------------------------------------------- several targets


def enumerated(rows, detected, z, sensor, log_nobody):
    """Existence, association probabilities (rows, 1 + N) given existence, by all joint associations."""
    logs = [[correct(mean, covariance, one, sensor)[2] for one in z] for mean, covariance, _ in rows]
    shares = np.zeros((len(rows), len(z) + 1))
    for choice in itertools.product(range(len(z) + 1), repeat=len(rows)):
        taken = [one for one in choice if one]
        if len(set(taken)) < len(taken):
            continue
        weight = 1.0
        for row, column in enumerate(choice):
            r = rows[row][2]
            if column:
                weight *= r * detected * math.exp(logs[row][column - 1] - log_nobody)
            else:
                weight *= 1.0 - r * detected
        for row, column in enumerate(choice):
            shares[row, column] += weight
    shares /= shares.sum(axis=1, keepdims=True)
    r = np.array([one[2] for one in rows])
    missed = shares[:, 0] * r * (1 - detected) / (1 - r * detected)
    existence = shares[:, 1:].sum(axis=1) + missed
    return existence, np.column_stack([missed, shares[:, 1:]]) / existence[:, None]


def mixed(mean, covariance, z, shares, sensor):
    parts = [(mean, covariance), *(correct(mean, covariance, one, sensor)[:2] for one in z)]
    centre = sum(share * one for share, (one, _) in zip(shares, parts, strict=True))
    spread = sum(
        share * (own + np.outer(one - centre, one - centre))
        for share, (one, own) in zip(shares, parts, strict=True)
    )
    return centre, spread


@pytest.mark.parametrize("seed", range(4))
def test_shared_detections_are_the_sum_over_all_associations(seed):
    """Two targets close together, unconfirmed beside them, false detections: one look, by enumeration."""
    rng = np.random.default_rng(seed)
    at = np.array([[-100.0, 3.0], [-100.0, -4.0]])
    looks = []
    for _ in range(6):
        z = np.stack([np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])], 1)
        z = z + rng.normal(size=z.shape) * [2.0, 0.01]
        z[:, 1] = (z[:, 1] + np.pi) % (2 * np.pi) - np.pi
        looks.append({"radar": z[rng.permutation(2)].tolist()})
    looks.append({"radar": [*looks[-1]["radar"], [101.0, math.pi - 0.01]]})
    checked = graph({"radar": RADAR}, "marginal", clutter=2.0, detection=0.9)
    before, after = (one.state for one in outcomes(checked, looks)[-2:])
    rows = []
    for target in before.targets.values():
        rows.append((*predicted(*moments(target.belief), 1.0), SURVIVAL * target.existence))
    unconfirmed = before.history.detection_models["ship"].unconfirmed
    for mean, covariance, existence in zip(
        unconfirmed.mean, unconfirmed.covariance, unconfirmed.existence, strict=True
    ):
        own = mean[COLUMNS], covariance[np.ix_(COLUMNS, COLUMNS)]
        rows.append((*predicted(*own, 1.0), SURVIVAL * existence))
    volume = 1000.0 * 2 * math.pi
    z = looks[-1]["radar"]
    existence, shares = enumerated(rows, 0.9, z, radar, math.log((2.0 + 0.1) / volume))
    assert len(before.targets) == 2
    for row, target in enumerate(after.targets.values()):
        if row >= len(before.targets):
            continue
        assert target.existence == pytest.approx(existence[row], abs=1e-6)
        mean, covariance = mixed(*rows[row][:2], z, shares[row], radar)
        own, spread = moments(target.belief)
        # Shares below a thousandth are left out.
        assert own == pytest.approx(mean, abs=0.05)
        assert spread == pytest.approx(covariance, abs=0.2)


def test_two_sensors_with_rates_of_their_own_are_taken_in_turn():
    """A radar every third frame, a place in every one: the update by one after that by the other."""
    _, polar, places = path(16, 8)
    looks = [
        {"gps": [places[k].tolist()]} | ({"radar": [polar[k].tolist()]} if k % 3 == 0 else {})
        for k in range(16)
    ]
    checked = graph({"gps": GPS, "radar": RADAR}, clutter=1e-9, detection=0.999)
    done = outcomes(checked, looks)
    mean, covariance = place(places[0], gps)
    mean, covariance, _ = correct(mean, covariance, polar[0], radar)
    for k in range(1, 16):
        mean, covariance = predicted(mean, covariance, 1.0)
        mean, covariance, _ = correct(mean, covariance, places[k], gps)
        if k % 3 == 0:
            mean, covariance, _ = correct(mean, covariance, polar[k], radar)
        (state,) = done[k].state.targets.values()
        own, spread = moments(state.belief)
        assert own == pytest.approx(mean, abs=1e-5)
        assert spread == pytest.approx(covariance, rel=1e-4, abs=1e-5)


def test_a_sensor_that_does_not_look_takes_nothing_from_existence():
    """No row: existence falls by `survival` alone; a look that saw nothing lowers it."""
    _, _, places = path(6, 2)
    looks = [{"gps": [z.tolist()]} for z in places]
    quiet = outcomes(graph({"gps": GPS}), [*looks, {}])[-1]
    empty = outcomes(graph({"gps": GPS}), [*looks, {"gps": []}])[-1]
    known = outcomes(graph({"gps": GPS}), looks)[-1].state.targets["1"].existence
    r = SURVIVAL * known
    assert quiet.state.targets["1"].existence == pytest.approx(r)
    assert empty.state.targets["1"].existence == pytest.approx(r * 0.1 / (1 - r * 0.9))


# ---------------------------------------------------------------- births


@pytest.mark.parametrize("sensor", ["followed", "written"])
def test_a_target_starts_where_h_has_the_values_measured(sensor):
    """By following h, and by the inverse that is written: the same place, the same covariance."""
    node = dict(RADAR)
    if sensor == "written":
        node["inverse"] = {"x": "range * cos(bearing)", "y": "range * sin(bearing)"}
    rng = np.random.default_rng(4)
    z = np.stack([rng.uniform(5, 900, 200), rng.uniform(-math.pi, math.pi, 200)], axis=1)
    done = outcomes(graph({"radar": node}), [{"radar": z.tolist()}])[0]
    unconfirmed = done.state.history.detection_models["ship"].unconfirmed
    assert len(unconfirmed) == 200
    for one, mean, covariance in zip(
        z[unconfirmed.number], unconfirmed.mean, unconfirmed.covariance, strict=True
    ):
        wanted, spread = place(one, radar)
        assert mean[COLUMNS] == pytest.approx(wanted, abs=1e-6)
        assert covariance[np.ix_(COLUMNS, COLUMNS)] == pytest.approx(spread, rel=1e-5, abs=1e-9)


def test_a_third_quantity_is_used_as_well():
    """Range, bearing and their rate: the rate tells the velocity along the line of sight at once."""
    node = {
        "parent": "ship",
        "agent": {
            "detection": {
                "sd": {"range": 2.0, "bearing": 0.01, "rate": 0.5},
                "within": {"range": [0, 1000], "bearing": [-math.pi, math.pi], "rate": [-50, 50]},
            }
        },
        "measures": {
            "range": "hypot(x, y)",
            "bearing": "atan2(y, x)",
            "rate": "(x * vx + y * vy) / hypot(x, y)",
        },
    }

    class Rates(Given):
        def scans(self, frame):
            return {"radar": Scan(np.array([[100.0, 0.0, -8.0]]), np.ones(1))}

    checked = graph({"radar": node})
    engine = make_engine(checked, 0, detectors={"detections": Rates([])})
    first = start_targets(checked, engine, Frame(index=0, time=0.0, time_s=0.0, image=BLACK), ())
    unconfirmed = first.state.history.detection_models["ship"].unconfirmed
    expected = START_SD**2 / (START_SD**2 + 0.5**2) * -8.0
    assert unconfirmed.mean[0, 4] == pytest.approx(expected, rel=1e-3)
    assert unconfirmed.covariance[0, 4, 4] == pytest.approx(1 / (1 / START_SD**2 + 1 / 0.5**2), rel=1e-3)
    assert unconfirmed.covariance[0, 5, 5] == pytest.approx(START_SD**2, rel=1e-3)


def test_unscented_and_extended_agree_where_h_is_linear():
    """The moments of a linear h are exact by sigma points, too."""
    _, _, places = path(10, 6)
    looks = [{"gps": [z.tolist(), [200.0, 200.0]]} for z in places]
    runs = [outcomes(graph({"gps": GPS}, "marginal", one), looks)[-1] for one in ("extended", "unscented")]
    for first, second in zip(*(one.state.targets.values() for one in runs), strict=True):
        assert first.belief.mean == pytest.approx(second.belief.mean, abs=1e-6)
        assert first.belief.covariance == pytest.approx(second.belief.covariance, abs=1e-5)


def test_the_best_detections_of_a_scan_come_first():
    """`scan` hands them out by their scores, with their numbers in the look."""

    class Scored(Given):
        def scans(self, frame):
            return {"gps": Scan(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.3, 0.9]))}

    engine = make_engine(graph({"gps": GPS}), 0, detectors={"detections": Scored([])})

    class Work:
        frame = Frame(index=0, time=0.0, time_s=0.0, image=BLACK)

    Work.engine = engine
    found = scan(Work, "ship")["gps"]
    assert found.values.tolist() == [[3.0, 4.0], [1.0, 2.0]]
    assert found.numbers.tolist() == [1, 0]
