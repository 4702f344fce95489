"""SORT, ByteTrack, OC-SORT, norfair and Stone-Soup's JPDA on detections, in an environment of their own.

The benchmarks of crowds start this file with the interpreter of an environment that has `trackers` and
`norfair`, or `stonesoup`; it needs nothing else of the project. The request is a JSON object on the
standard input: the trackers, and sequences of frames, each a list of left, top, right, bottom, score. The
answer is the versions and, of each sequence and tracker, the CPU seconds of every update and its tracks, a
list of id, left, top, right, bottom for every frame.

Stone-Soup is told the size of the image and the true rates of detection and of false boxes. It tracks centres
alone, with the noise of the graph `jpda`; its boxes are all of one size, which GOSPA of centres does not look
at. Its JPDA goes through all joint hypotheses, of which there are very many where tracks lie close.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

FIELD = ("SORT", "ByteTrack", "OC-SORT", "OC-SORT, corners", "norfair")
STONE_SOUP = "Stone-Soup JPDA"
SIZE = np.array([30.0, 75.0])
"""Width and height of Stone-Soup's boxes, px."""


def rows_of(detections: Any) -> list[list[float]]:
    """Rows of left, top, right, bottom, score of the detections of a frame, whose boxes are centre boxes."""
    half = detections.boxes[:, 2:] / 2
    centre = detections.boxes[:, :2]
    return np.column_stack([centre - half, centre + half, detections.scores]).tolist()  # type: ignore[no-any-return]


def ask(python: str, trackers: Sequence[str], sequences: Iterable[Any], **settings: Any) -> dict[str, Any]:
    """The answer of this file under another interpreter: `versions`, and `figures` of each sequence."""
    request = json.dumps({"trackers": trackers, "sequences": [*sequences], **settings})
    done = subprocess.run([python, __file__], input=request, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{python}: {done.stderr[-2000:]}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


@dataclass(frozen=True)
class Kind:
    """A tracker: the rows of a frame as it wants them, its update, and the tracks in what that returns."""

    prepare: Callable[[Any], Any]
    update: Callable[[Any], Any]
    read: Callable[[Any], list[list[float]]]


def norfair_kind() -> Kind:
    """norfair by IoU; its tracks are not read."""
    import norfair

    tracker = norfair.Tracker(distance_function="iou", distance_threshold=0.7)
    return Kind(
        lambda rows: [norfair.Detection(np.array(row[:4]).reshape(2, 2)) for row in rows],
        tracker.update,
        lambda _: [],
    )


def field_kind(name: str) -> Kind:
    """A tracker of `trackers`, with its defaults."""
    import supervision
    import trackers

    kinds = {"SORT": "SORTTracker", "ByteTrack": "ByteTrackTracker", "OC-SORT": "OCSORTTracker"}
    settings: dict[str, Any] = {}
    if name == "OC-SORT, corners":
        from trackers.utils.state_representations import XYXYStateEstimator  # of version 2.6

        settings["state_estimator_class"] = XYXYStateEstimator
    tracker = getattr(trackers, kinds[name.partition(",")[0]])(**settings)

    def prepare(rows: Any) -> Any:
        # Double precision, so that a score of 0.7 is not below 0.7.
        given = np.array(rows, dtype=np.float64).reshape(-1, 5)
        return supervision.Detections(xyxy=given[:, :4], confidence=given[:, 4])

    def read(found: Any) -> list[list[float]]:
        ids = [] if found.tracker_id is None else found.tracker_id.tolist()
        return [[i, *box] for i, box in zip(ids, found.xyxy.tolist(), strict=True) if i >= 0] if ids else []

    return Kind(prepare, tracker.update, read)


def stone_soup(size: Sequence[int], detected: float, clutter: float) -> Kind:
    """A JPDA of centres, started by three detections, ended by misses."""
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
    near = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)
    deleter = UpdateTimeStepsDeleter(5)
    initiator = MultiMeasurementInitiator(
        prior_state=GaussianState(np.zeros((4, 1)), np.diag([0.0, 25.0, 0.0, 25.0]), timestamp=start),
        deleter=deleter,
        data_associator=GNNWith2DAssignment(near),
        updater=updater,
        min_points=3,
        measurement_model=seen,
    )
    tracks: set[Any] = set()
    numbers: dict[str, int] = {}
    frames = iter(range(10**9))

    def advance(track: Any, hypotheses: Any, now: datetime) -> set[Any]:
        """Append the mixture of the hypotheses to the track; the detections that it takes."""
        states = [updater.update(one) if one else one.prediction for one in hypotheses]
        weights = np.array([float(one.probability) for one in hypotheses])
        vectors = StateVectors([state.state_vector for state in states])
        mean, covariance = gm_reduce_single(vectors, np.stack([s.covar for s in states], axis=2), weights)
        if any(one and one.probability > 0.1 for one in hypotheses):
            track.append(GaussianStateUpdate(mean, covariance, hypotheses, now))
        else:
            track.append(hypotheses[0].prediction)
        return {one.measurement for one in hypotheses if one and one.probability > 0.5}

    def update(rows: Any) -> set[Any]:
        now = start + timedelta(seconds=next(frames))
        centres = (rows[:, :2] + rows[:, 2:4]) / 2
        found = {Detection(one.reshape(2, 1), timestamp=now, measurement_model=seen) for one in centres}
        taken: set[Any] = set()
        for track, hypotheses in associator.associate(tracks, found, now).items():
            taken |= advance(track, hypotheses, now)
        tracks.difference_update(deleter.delete_tracks(tracks, timestamp=now))
        tracks.update(initiator.initiate(found - taken, now))
        return tracks

    def read(live: set[Any]) -> list[list[float]]:
        reported = []
        for track in live:
            centre = np.ravel(track.state_vector)[[0, 2]].astype(float)
            number = numbers.setdefault(track.id, len(numbers) + 1)
            reported.append([number, *(centre - SIZE / 2).tolist(), *(centre + SIZE / 2).tolist()])
        return reported

    return Kind(lambda rows: np.array(rows, float).reshape(-1, 5), update, read)


def run(kind: Kind, frames: Iterable[Any]) -> dict[str, Any]:
    """Seconds of each update, and the tracks."""
    seconds, tracks = [], []
    for given in [kind.prepare(rows) for rows in frames]:
        started = time.process_time()
        found = kind.update(given)
        seconds.append(time.process_time() - started)
        tracks.append(kind.read(found))
    return {"seconds": seconds, "tracks": tracks}


def versions() -> dict[str, str]:
    """Of the packages that are installed here."""
    known = {}
    for name in ("trackers", "norfair", "stonesoup"):
        try:
            known[name] = version(name)
        except PackageNotFoundError:
            continue
    return known


def main() -> None:
    """Answer the request on the standard input."""
    warnings.filterwarnings("ignore")
    request = json.load(sys.stdin)
    figures = []
    for frames in request["sequences"]:
        of_each = {}
        for name in request["trackers"]:
            if name == STONE_SOUP:
                kind = stone_soup(request["size"], request["detected"], request["clutter"])
            else:
                kind = norfair_kind() if name == "norfair" else field_kind(name)
            of_each[name] = run(kind, frames)
        figures.append(of_each)
    print(json.dumps({"versions": versions(), "figures": figures}))


if __name__ == "__main__":
    main()
