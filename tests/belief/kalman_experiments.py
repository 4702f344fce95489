"""The tracking chapter's experiments with Kalman filters, run through the beliefs of the package.

What they measure is a place, x and y with Gaussian error, as an agent that measures would; the scenes are
paths without pictures, so that the truth and the noise are known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, BeliefFilter, Evidence, MotionModel, Step, estimate
from bayesnet_track.belief.gaussian.belief import GaussianFilter
from bayesnet_track.belief.motion.formulas import FunctionMotion
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Hypotheses, Measurement

Floats = NDArray[np.float64]

SD = 4.0
"""Error of a measured coordinate, px."""

SIZE = 20.0
HIDDEN = slice(25, 40)
"""Frames of the occlusion."""


@dataclass(frozen=True, eq=False)
class Track:
    """One filter on one path.

    Attributes:
        truth: (T, 2) places, px.
        measured: (T, 2) measurements; NaN where there was none.
        predicted: (T, 2) means before the frame's measurement.
        estimated: (T, 2) means after it.
        covariance: (T, 2, 2) of the estimate.
        gated: (T,) True where the measurement was not used.
    """

    truth: Floats
    measured: Floats
    predicted: Floats
    estimated: Floats
    covariance: Floats
    gated: NDArray[np.bool_]

    def inside(self, share: float = 0.9) -> NDArray[np.bool_]:
        """(T,) True where the truth lies inside the ellipse that holds this share of the belief."""
        away = self.truth[1:] - self.estimated[1:]
        d2 = np.einsum("nk,nk->n", away, np.linalg.solve(self.covariance[1:], away[:, :, None])[:, :, 0])
        return np.append(True, d2 < chi_square_quantile(share, 2))


def rmse(tracks: Sequence[Track], frames: slice = slice(0, None), part: str = "estimated") -> Floats:
    """(runs,) root mean square distance from the truth over the frames of each run, px."""
    away = np.array([getattr(track, part)[frames] - track.truth[frames] for track in tracks])
    return np.asarray(np.sqrt(np.mean(np.sum(np.square(away), axis=2), axis=1)))


# ------------------------------------------------------------------------------------ paths


def uniform(frames: int = 60) -> Floats:
    """A ball that rolls evenly across a picture of 320 x 240."""
    return np.asarray(np.array([30.0, 190.0]) + np.arange(frames)[:, None] * np.array([4.4, -2.6]))


def manoeuvre(speed: float = 6.0, rate: float = 0.2) -> Floats:
    """Straight for 20 frames, a turn at 0.2 rad per frame for 24, and straight again for 16."""
    turning = np.concatenate([np.zeros(20), np.full(24, rate), np.zeros(16)])
    heading = np.cumsum(turning) - turning / 2
    steps = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.array([60.0, 90.0]) + np.cumsum(steps, axis=0)


def measure(truth: Floats, seed: int) -> Floats:
    """(T, 2) measurements with an error of SD on each axis."""
    return truth + SD * np.random.default_rng(seed).standard_normal(truth.shape)


# ------------------------------------------------------------------------------------ models


def constant_velocity(sd_velocity: float) -> MotionModel:
    """The chapter's uniform motion, its velocity drifting by `sd_velocity` px per frame, per frame."""
    return make_motion(
        spec.Motion.model_validate(
            {"constant_velocity": {"sd_velocity_px": sd_velocity, "start_velocity_sd_px": 6.0}}
        )
    )


def damped_velocity(sd_velocity: float) -> MotionModel:
    """Eq. 3.91, corrected: the velocity decays by e^(-1/4) per frame."""
    return make_motion(
        spec.Motion.model_validate(
            {"damped_velocity": {"sd_velocity_px": sd_velocity, "start_velocity_sd_px": 6.0}}
        )
    )


def turn(states: Floats, dt: float) -> Floats:
    """Motion along an arc at the turn rate of the state (radians per frame)."""
    x, y, w, h, vx, vy, rate = states.T
    angle = rate * dt
    # sin(a) / a and (1 - cos(a)) / a, right at 0 too.
    along, across = dt * np.sinc(angle / np.pi), dt * np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    moved = (x + along * vx - across * vy, y + across * vx + along * vy)
    return np.stack([*moved, w, h, cos * vx - sin * vy, sin * vx + cos * vy, rate], axis=1)


def turning() -> MotionModel:
    """A coordinated turn: the rate, unknown at first, drifts by .06 rad per frame, the velocity by .4 px."""
    return FunctionMotion(
        (*BOX_FIELDS, "vx", "vy", "rate"),
        turn,
        np.diag([0.1, 0.1, 0.0, 0.0, 0.4, 0.4, 0.06]) ** 2,
        start_sd=(6.0, 6.0, 0.1),
    )


# ------------------------------------------------------------------------------------ running


def follow(
    belief: BeliefFilter[Any], motion: MotionModel, truth: Floats, measured: Floats, seed: int
) -> Track:
    """One filter along a path; it starts in the true place with an unknown velocity."""
    streams = Streams(seed)
    box = np.array([*truth[0], SIZE, SIZE])
    now = belief.start(box, motion, partial(streams.of, "1", "root", 0))
    predicted, estimated, spread, gated = [truth[0]], [truth[0]], [np.zeros((2, 2))], [False]
    for frame in range(1, len(truth)):
        seen: list[Floats] = []
        stream = partial(streams.of, "1", "root", frame)
        step = belief.step(now, motion, 1.0, _evidence(measured[frame], seen), stream)
        now = step.posterior
        predicted.append(seen[0])
        estimated.append(now.mean[:2])
        spread.append(now.covariance[:2, :2])
        gated.append(bool(step.reports) and not np.isnan(measured[frame]).any())
    return Track(truth, measured, np.array(predicted), np.array(estimated), np.array(spread), np.array(gated))


def _evidence(z: Floats, seen: list[Floats]) -> Callable[[Hypotheses, Floats], Evidence]:
    """An agent that measured z, or saw nothing; the mean of what it was asked about goes to `seen`."""

    def evaluate(hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
        seen.append(np.exp(prior_log) @ hypotheses.boxes[:, :2])
        nothing = np.zeros(len(hypotheses))
        if np.isnan(z).any():
            return Evidence(nothing)
        log = -0.5 * np.sum(((hypotheses.boxes[:, :2] - z) / SD) ** 2, axis=1)
        message = Measurement(("x", "y"), z, SD**2 * np.eye(2))
        return Evidence(log, {"ball": log}, gaussians={"ball": message}, sampled=nothing)

    return evaluate


def gaussian(kind: str, gate: float = 0.99) -> GaussianFilter:
    """A Gaussian belief with few hypotheses: nothing here is asked of them."""
    return GaussianFilter(spec.Gaussian.model_validate({"filter": kind, "gate": gate, "samples": 20}))


# ------------------------------------------------------------------------------------ the experiments


def uniform_motion(runs: int) -> list[Track]:
    """Figure 3.11: the Kalman filter on uniform motion."""
    path, motion = uniform(), constant_velocity(0.2)
    return [follow(gaussian("kalman"), motion, path, measure(path, seed), seed) for seed in range(runs)]


def occlusion(runs: int) -> dict[str, list[Track]]:
    """Figure 3.12: hidden for 15 frames, in which another ball is measured (or nothing is).

    The other ball lies 70 px beside the path. With the gate its measurements are not used, as if there were
    none; without, the filter follows it.
    """
    path, motion = uniform(), constant_velocity(0.2)
    found: dict[str, list[Track]] = {"nothing seen": [], "another, gate .99": [], "another, no gate": []}
    for seed in range(runs):
        measured = measure(path, seed)
        unseen, other = measured.copy(), measured.copy()
        unseen[HIDDEN] = np.nan
        other[HIDDEN] += np.array([2.6, 4.4]) / np.hypot(2.6, 4.4) * 70.0
        for name, what, gate in zip(found, (unseen, other, other), (0.99, 0.99, 1.0), strict=True):
            found[name].append(follow(gaussian("kalman", gate), motion, path, what, seed))
    return found


def manoeuvres(runs: int, names: Sequence[str] = ()) -> dict[str, list[Track]]:
    """Figure 3.13: a turn, by filters of the chapter's models and of a turn at an unknown rate."""
    path = manoeuvre()
    filters: dict[str, tuple[BeliefFilter[Any], MotionModel]] = {
        "Kalman, uniform motion": (gaussian("kalman", 1.0), constant_velocity(0.2)),
        "Kalman, wide noise": (gaussian("kalman", 1.0), constant_velocity(1.5)),
        "Kalman, damped velocity": (gaussian("kalman", 1.0), damped_velocity(2.5)),
        "EKF, turn": (gaussian("extended", 1.0), turning()),
        "UKF, turn": (gaussian("unscented", 1.0), turning()),
        "particles, turn": (ParticleFilter(spec.Particles(size=1000)), turning()),
    }
    return {
        name: [follow(belief, motion, path, measure(path, seed), seed) for seed in range(runs)]
        for name, (belief, motion) in filters.items()
        if not names or name in names
    }


TARGET, OTHER = np.array([120.0, 120.0]), np.array([200.0, 120.0])
"""Two modes, 80 px apart; the other one's peak is lower by a fifth."""


def two_modes(hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
    """A likelihood of two modes of sd 8 px, 1 at the target and .8 at another object."""
    target, other = (
        -0.5 * np.sum(((hypotheses.boxes[:, :2] - at) / 8.0) ** 2, axis=1) for at in (TARGET, OTHER)
    )
    log = np.minimum(np.logaddexp(target, np.log(0.8) + other), 0.0)
    return Evidence(log, {"color": log})


ESTIMATES: dict[str, Any] = {
    "mean": "mean",
    "best": "max_weight",
    "robust_mean": {"robust_mean": {"box": 0.5}},
}
"""The chapter's three; the window of the robust mean reaches 20 px, 2.5 sds of a mode."""


def bimodal(runs: int, size: int = 500) -> dict[str, Floats]:
    """Figure 3.16: estimate -> (runs, 2) places of particles whose posterior has two modes.

    `gaussian` is the mean of a Gaussian belief of as many samples.
    """
    particles = ParticleFilter(spec.Particles(size=size))
    one_mode = GaussianFilter(spec.Gaussian(samples=size))
    found: dict[str, list[Floats]] = {kind: [] for kind in (*ESTIMATES, "gaussian")}
    for seed in range(runs):
        step = two_mode_step(particles, seed)
        for kind, chosen in ESTIMATES.items():
            found[kind].append(estimate(spec.Estimate.model_validate(chosen), step)[:2])
        found["gaussian"].append(two_mode_step(one_mode, seed).posterior.mean[:2])
    return {kind: np.array(places) for kind, places in found.items()}


def two_mode_step(belief: BeliefFilter[Any], seed: int) -> Step[Any]:
    """One frame between the two modes, after a random walk of 40 by 20 px from halfway."""
    motion = make_motion(spec.Motion.model_validate({"random_walk": {"sd_px": {"x": 40.0, "y": 20.0}}}))
    streams = [partial(Streams(seed).of, "1", "root", frame) for frame in (0, 1)]
    start = belief.start(np.array([160.0, 120.0, 40.0, 40.0]), motion, streams[0])
    return belief.step(start, motion, 1.0, two_modes, streams[1])


def held(places: Floats) -> int:
    """How many of the places (N, 2) lie within 10 px of the target."""
    return int(np.sum(np.linalg.norm(places - TARGET, axis=1) < 10.0))
