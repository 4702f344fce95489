"""SORT of `trackers`, and a JPDA of Stone-Soup, on sequences of detections: for `crowd_association.py`.

    python benchmarks/crowd_association_peers.py < sequences.json

Runs in an environment with `trackers` or `stonesoup` and needs nothing else of the project. Reads the
tracker, the size of the image, the true rates of detection and of false boxes (Stone-Soup is told them), and
sequences: of each frame the centre boxes that were detected. Prints, of each sequence, rows of frame,
identity and centre box. Stone-Soup tracks centres alone, with the noise of the graph `jpda`; its boxes are
all of one size, which GOSPA of centres does not look at. Its JPDA goes through all joint hypotheses, of which
there are very many where tracks lie close or false boxes are many.
"""

from __future__ import annotations

import json
import sys
import warnings
from datetime import datetime, timedelta
from typing import Any

import numpy as np

warnings.filterwarnings("ignore")

Row = tuple[int, int, list[float]]


def sort(frames: list[Any], size: tuple[int, int]) -> list[Row]:
    """SORT with its defaults, every confidence 1."""
    import supervision
    from trackers import SORTTracker

    tracker, rows = SORTTracker(), list[Row]()
    for index, boxes in enumerate(frames):
        centre = np.array(boxes, dtype=np.float32).reshape(-1, 4)
        corners = np.hstack([centre[:, :2] - centre[:, 2:] / 2, centre[:, :2] + centre[:, 2:] / 2])
        given = supervision.Detections(xyxy=corners, confidence=np.ones(len(corners), np.float32))
        found = tracker.update(given)
        for number, corner in zip(found.tracker_id, found.xyxy, strict=True):
            if number >= 0:
                middle, sides = (corner[:2] + corner[2:]) / 2, corner[2:] - corner[:2]
                rows.append((index, int(number), [float(v) for v in (*middle, *sides)]))
    return rows


def stonesoup(frames: list[Any], size: tuple[int, int], detected: float, clutter: float) -> list[Row]:
    """A JPDA of centres with known clutter and detection, started by single points, ended by misses."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDA
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.functions import gm_reduce_single
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.update import GaussianStateUpdate
    from stonesoup.updater.kalman import KalmanUpdater

    start = datetime(2000, 1, 1)
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.49), ConstantVelocity(0.49)])
    seen = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=np.diag([9.0, 9.0]))
    predictor, updater = KalmanPredictor(motion), KalmanUpdater(seen)
    density = max(clutter, 0.1) / (size[0] * size[1])
    associator = JPDA(PDAHypothesiser(predictor, updater, density, detected, prob_gate=0.999))
    prior = GaussianState(np.zeros((4, 1)), np.diag([0.0, 25.0, 0.0, 25.0]), timestamp=start)
    near = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)
    deleter = UpdateTimeStepsDeleter(5)
    initiator = MultiMeasurementInitiator(
        prior_state=prior,
        deleter=deleter,
        data_associator=GNNWith2DAssignment(near),
        updater=updater,
        min_points=3,
        measurement_model=seen,
    )
    tracks: set[Any] = set()
    numbers: dict[str, int] = {}
    rows = list[Row]()
    for index, boxes in enumerate(frames):
        now = start + timedelta(seconds=index)
        found = {
            Detection(np.array([[box[0]], [box[1]]]), timestamp=now, measurement_model=seen) for box in boxes
        }
        used: set[Any] = set()
        for track, hypotheses in associator.associate(tracks, found, now).items():
            states, weights = [], []
            for one in hypotheses:
                states.append(updater.update(one) if one else one.prediction)
                weights.append(float(one.probability))
                if one and one.probability > 0.5:
                    used.add(one.measurement)
            vectors = StateVectors([state.state_vector for state in states])
            covariances = np.stack([state.covar for state in states], axis=2)
            mean, covariance = gm_reduce_single(vectors, covariances, np.array(weights))
            is_seen = any(one and one.probability > 0.1 for one in hypotheses)
            if is_seen:
                track.append(GaussianStateUpdate(mean, covariance, hypotheses, now))
            else:
                track.append(hypotheses[0].prediction)
        tracks -= deleter.delete_tracks(tracks, timestamp=now)
        tracks |= initiator.initiate(found - used, now)
        for track in tracks:
            x, _, y, _ = (float(value) for value in np.ravel(track.state_vector))
            number = numbers.setdefault(track.id, len(numbers) + 1)
            rows.append((index, number, [x, y, 30.0, 75.0]))
    return rows


def main() -> None:
    """Print the tracks of the sequences on the standard input."""
    asked = json.load(sys.stdin)
    size = asked["size"]
    if asked["tracker"] == "SORT":
        found = [sort(frames, size) for frames in asked["sequences"]]
    else:
        found = [
            stonesoup(frames, size, asked["detected"], asked["clutter"]) for frames in asked["sequences"]
        ]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
