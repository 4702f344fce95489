"""The importance functions of thesis 5.5 against exact answers, at equal cost.

Usage: python benchmarks/importance.py [--runs 40]

Prints the KL estimate (5.30) against quadrature, the evidence of every method against the closed form, and
the error of 40 steps against the exact Kalman filter beside a plain filter of twice the hypotheses.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evaluate, Evidence, Step
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian, make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter, ParticleSet
from bayesnet_track.belief.particles.importance import surprise
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Hypotheses

Floats = NDArray[np.float64]

BOX = np.array([160.0, 120.0, 60.0, 50.0])
R = 4.0
"""Sd of the measured x and y, px."""

THESIS = {"second_pass": {"by": "parents", "neighbours": 1, "weights": "second_only", "defensive": 0.0}}
METHODS: Mapping[str, object] = {
    "second_pass": "second_pass",
    "adaptive, parents": {"second_pass": {"by": "parents"}},
    "thesis as printed": THESIS,
    "auxiliary": "auxiliary",
    "prior_editing": "prior_editing",
    "iterated": "iterated",
    "likelihood mixture": "likelihood_mixture",
}


def motion_of(kind: str, **settings: object) -> KinematicMotion:
    """A motion model of the language."""
    return make_motion(spec.Motion.model_validate({kind: settings}))


MODELS = {
    "constant velocity": motion_of("constant_velocity", sd_velocity_px=2.0, start_velocity_sd_px=5.0),
    "random walk": motion_of("random_walk", sd_px={"x": 20.0, "y": 20.0}),
}
JUMP_PX = {"constant velocity": 20.0, "random walk": 80.0}


def particle_filter(size: int, importance: object, above_kl: float | None = None) -> ParticleFilter:
    """A filter; `above_kl` overrides that of a method that has one."""
    settings = spec.Particles.model_validate({"size": size, "proposal": importance})
    if above_kl is not None and hasattr(settings.proposal.settings, "above_kl"):
        kind = settings.proposal.kind
        changed = settings.proposal.settings.model_copy(update={"above_kl": above_kl})
        chosen = settings.proposal.model_copy(update={kind: changed})
        settings = settings.model_copy(update={"proposal": chosen})
    return ParticleFilter(settings)


def measured(place: Floats) -> Evaluate:
    """The evidence of a measurement (2,) of the centre, a density."""

    def evaluate(hypotheses: Hypotheses, log_prior: Floats) -> Evidence:
        away = (hypotheses.boxes[:, :2] - place) / R
        return Evidence(-0.5 * np.sum(away**2, axis=1) - 2 * np.log(R * np.sqrt(2 * np.pi)))

    return evaluate


def stream_of(seed: int, frame: int) -> Callable[[str], np.random.Generator]:
    """The random streams of one target and frame."""
    return lambda purpose: Streams(seed).of("1", "root", frame, purpose)


def standard_error(values: Floats) -> float:
    """Of the mean."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values)))


# ------------------------------------------------------------------------------------ 5.30


def kl_of_draws(size: int, seed: int) -> float:
    """(5.30) on draws from q = N(2, 4)/2 + N(7, 4)/2 with weights p/q, p = N(3, 2)/2 + N(10, 2)/2."""
    rng = np.random.default_rng(seed)
    x = np.where(rng.random(size) < 0.5, 2.0, 7.0) + 2.0 * rng.standard_normal(size)
    log_p = np.logaddexp(-((x - 3) ** 2) / 4, -((x - 10) ** 2) / 4) - 0.5 * np.log(2)
    log_q = np.logaddexp(-((x - 2) ** 2) / 8, -((x - 7) ** 2) / 8) - 0.5 * np.log(4)
    return surprise(np.full(size, -np.log(size)), log_p - log_q)


def kl_true() -> float:
    """KL(p, q) by quadrature."""
    x = np.linspace(-20.0, 30.0, 200_001)
    p = (np.exp(-((x - 3) ** 2) / 4) + np.exp(-((x - 10) ** 2) / 4)) / (2 * np.sqrt(4 * np.pi))
    q = (np.exp(-((x - 2) ** 2) / 8) + np.exp(-((x - 7) ** 2) / 8)) / (2 * np.sqrt(8 * np.pi))
    return float(np.sum(np.where(p > 0, p * np.log(np.maximum(p, 1e-300) / q), 0.0)) * (x[1] - x[0]))


def print_kl(runs: int) -> None:
    """The estimate (5.30) at three sample sizes."""
    print(f"KL (5.30) against quadrature {kl_true():.4f}")
    for size in (200, 1000, 5000):
        found = np.array([kl_of_draws(size, seed) for seed in range(runs)])
        print(f"  N = {size:5d}: {found.mean():.4f} ± {standard_error(found):.4f}, sd {found.std():.4f}")


# ------------------------------------------------------------------------------------ evidence


@dataclass(frozen=True)
class OneFrame:
    """One frame from a weighted particle prior, whose evidence has a closed form."""

    motion: KinematicMotion
    prior: ParticleSet
    place: Floats

    @property
    def log_evidence(self) -> float:
        moves, spread = linear_gaussian(self.motion, 1.0)
        look = np.eye(2, len(moves))
        covariance = look @ spread @ look.T + R**2 * np.eye(2)
        away = self.place - self.prior.states @ moves.T @ look.T
        squares = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
        log_density = -0.5 * (squares + np.linalg.slogdet(2 * np.pi * covariance)[1])
        return float(np.logaddexp.reduce(self.prior.weights.log + log_density))

    def step(self, belief: ParticleFilter, seed: int) -> Step[ParticleSet]:
        return belief.step(self.prior, self.motion, 1.0, measured(self.place), stream_of(seed, 1))


def one_frame(model: str, off_px: float, size: int) -> OneFrame:
    """A prior of `size` uneven hypotheses and a measurement `off_px` away from what it predicts."""
    motion, rng = MODELS[model], np.random.default_rng(5)
    states = np.tile(np.r_[BOX, np.zeros(len(motion.fields) - 4)], (size, 1))
    states[:, :2] += 3.0 * rng.standard_normal((size, 2))
    states[:, 4:] += 2.0 * rng.standard_normal((size, len(motion.fields) - 4))
    weights = LogWeights.normalise(0.5 * rng.standard_normal(size))[0]
    return OneFrame(
        motion, ParticleSet(states, motion.fields, weights), BOX[:2] + np.array([off_px, off_px / 2])
    )


def relative_evidence(frame: OneFrame, belief: ParticleFilter, runs: int) -> Floats:
    """(runs,) estimates of the evidence over the exact one."""
    exact = frame.log_evidence
    return np.exp([frame.step(belief, seed).log_evidence - exact for seed in range(runs)])


def print_evidence(runs: int, size: int = 250) -> None:
    """Mean and sd of the evidence over the exact one, each method in every frame and in half of them."""
    for model, off in (("constant velocity", 8.0), ("random walk", 30.0)):
        frame = one_frame(model, off, size)
        print(f"evidence over the exact one, one frame, {model}, {off:g} px off, N = {size}")
        plain = relative_evidence(frame, particle_filter(2 * size, "bootstrap"), runs)
        print(f"  {'plain, 2 N':28s} {plain.mean():.4f} ± {standard_error(plain):.4f}, sd {plain.std():.3f}")
        kls = [frame_kl(frame, size, seed) for seed in range(60)]
        for name, importance in METHODS.items():
            triggered = particle_filter(size, importance, float(np.median(kls)))
            for what, belief in (("", particle_filter(size, importance, 0.0)), (" half the time", triggered)):
                if what and belief == particle_filter(size, importance, 0.0):
                    continue
                found = relative_evidence(frame, belief, runs)
                print(
                    f"  {name + what:28s} {found.mean():.4f} ± {standard_error(found):.4f}, "
                    f"sd {found.std():.3f}"
                )


def frame_kl(frame: OneFrame, size: int, seed: int) -> float:
    """The larger surprise of the two halves of a first pass."""
    step = frame.step(particle_filter(size, "bootstrap"), seed)
    likelihood = step.evidence.log_likelihood
    beta = np.full(size // 2, -np.log(size // 2))
    return max(surprise(beta, likelihood[k::2]) for k in (0, 1))


# ------------------------------------------------------------------------------------ 40 steps


def track(model: str, seed: int, jumps: bool) -> Floats:
    """(40, 2) measured centres of a target; with `jumps` it leaps away at every tenth step."""
    rng, motion = np.random.default_rng(seed), MODELS[model]
    state, places = motion.start(BOX, 1, rng), []
    for step in range(40):
        state = motion.propagate(state, 1.0, rng)
        if jumps and step % 10 == 9:
            angle = rng.uniform(0.0, 2 * np.pi)
            state[0, :2] += JUMP_PX[model] * np.array([np.cos(angle), np.sin(angle)])
        places.append(state[0, :2] + R * rng.standard_normal(2))
    return np.array(places)


def kalman_means(motion: KinematicMotion, places: Floats) -> Floats:
    """(T, 2) exact posterior means of the centre."""
    size = len(motion.fields)
    mean = np.r_[BOX, np.zeros(size - 4)]
    covariance = np.diag(np.r_[np.zeros(4), np.repeat(np.square(motion.start_sd), 2)])
    moves, spread = linear_gaussian(motion, 1.0)
    look, means = np.eye(2, size), []
    for place in places:
        mean, covariance = moves @ mean, moves @ covariance @ moves.T + spread
        gain = covariance @ look.T @ np.linalg.inv(look @ covariance @ look.T + R**2 * np.eye(2))
        mean, covariance = mean + gain @ (place - look @ mean), covariance - gain @ look @ covariance
        means.append(mean[:2])
    return np.array(means)


@dataclass(frozen=True)
class Run:
    """Mean squared error over the steps in R^2, and hypotheses evaluated per step."""

    error: float
    evaluations: float


def run(model: str, places: Floats, belief: ParticleFilter, seed: int) -> Run:
    """One filter over one track."""
    motion, evaluated, means = MODELS[model], [0], []
    now = belief.start(BOX, motion, stream_of(seed, 0))
    for frame, place in enumerate(places, start=1):
        inner = measured(place)

        def evaluate(hypotheses: Hypotheses, log_prior: Floats, inner: Evaluate = inner) -> Evidence:
            evaluated[0] += len(hypotheses)
            return inner(hypotheses, log_prior)

        now = belief.step(now, motion, 1.0, evaluate, stream_of(seed, frame)).posterior
        means.append(now.mean[:2])
    away = (np.array(means) - kalman_means(motion, places)) / R
    return Run(float(np.mean(away**2)), evaluated[0] / len(places))


def rmse(runs: list[Run]) -> tuple[float, float]:
    """Root mean square error over the runs, and its standard error by the delta method."""
    errors = np.array([one.error for one in runs])
    root = float(np.sqrt(errors.mean()))
    return root, standard_error(errors) / (2 * root)


def print_tracks(runs: int, size: int = 500) -> None:
    """Errors over 40 steps, quiet and with leaps."""
    for model in MODELS:
        for jumps in (False, True):
            places = [track(model, 100 + seed, jumps) for seed in range(runs)]
            what = f"a leap of {JUMP_PX[model]:g} px at every tenth step" if jumps else "quiet"
            print(f"40 steps against Kalman, {model}, {what}, {runs} runs: rmse/R, N = {size}")
            beliefs: dict[str, ParticleFilter] = {
                "plain, N": particle_filter(size, "bootstrap"),
                "plain, 2 N": particle_filter(2 * size, "bootstrap"),
                **{name: particle_filter(size, importance) for name, importance in METHODS.items()},
                "adaptive, every frame": particle_filter(size, "second_pass", 0.0),
                "west, every frame": particle_filter(size, "iterated", 0.0),
            }
            for name, belief in beliefs.items():
                begin = time.perf_counter()
                found = [run(model, one, belief, seed) for seed, one in enumerate(places)]
                ms = 1e3 * (time.perf_counter() - begin) / (40 * runs)
                root, error = rmse(found)
                middle = float(np.sqrt(np.median([one.error for one in found])))
                cost = np.mean([one.evaluations for one in found])
                print(
                    f"  {name:24s} {root:.3f} ± {error:.3f}, median run {middle:.3f}; "
                    f"{cost:5.0f} evaluations and {ms:.1f} ms a step"
                )


def main() -> None:
    """Print all parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=40, help="tracks of each kind; other parts take more")
    arguments = parser.parse_args()
    print_kl(10 * arguments.runs)
    print_evidence(25 * arguments.runs)
    print_tracks(arguments.runs)


if __name__ == "__main__":
    main()
