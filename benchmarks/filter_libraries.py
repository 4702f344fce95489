"""The bootstrap filters of libraries, of those that are installed: further peers of `benchmarks/filter.py`.

As a script it answers requests, one JSON object a line, so that libraries which want another environment take
their turn in the same run.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Mapping
from datetime import datetime, timedelta
from importlib.metadata import version
from typing import Any

import numpy as np
from filter_peers import Floats, Model, Start, Vectorised, log_mean, run
from numpy.typing import NDArray


class WithFilterpy(Vectorised):
    """As filterpy's author writes a particle filter: NumPy, and filterpy's resampling."""

    def __init__(self, model: Model, size: int, seed: int) -> None:
        super().__init__(model, size, seed)
        np.random.seed(seed)  # noqa: NPY002 - filterpy draws from there
        from filterpy.monte_carlo import systematic_resample

        self.resample = systematic_resample

    def ancestors(self) -> NDArray[Any]:
        return np.asarray(self.resample(self.weights))


class WithParticles:
    """`particles`: its bootstrap filter, which resamples in every step."""

    def __init__(self, model: Model, size: int, seed: int) -> None:
        import particles
        from particles import distributions, state_space_models

        np.random.seed(seed)  # noqa: NPY002 - `particles` draws from there
        spread = model.transition @ model.start @ model.transition.T + model.noise

        class Moving(state_space_models.StateSpaceModel):  # type: ignore[misc, unused-ignore]
            def PX0(self) -> Any:
                return distributions.MvNormal(loc=np.zeros(4), cov=spread)

            def PX(self, t: int, xp: Floats) -> Any:
                return distributions.MvNormal(loc=xp @ model.transition.T, cov=model.noise)

            def PY(self, t: int, xp: Floats, x: Floats) -> Any:
                return distributions.MvNormal(loc=x[:, :2], cov=model.measured_sd**2 * np.eye(2))

        bootstrap = state_space_models.Bootstrap(ssm=Moving(), data=list(model.measurements))
        self.filter = particles.SMC(
            fk=bootstrap, N=size, resampling="systematic", ESSrmin=1.0, collect="off", verbose=False
        )

    def step(self, measured: Floats) -> None:
        next(self.filter)

    def log_evidence(self) -> float:
        return float(self.filter.loglt)


class WithStoneSoup:
    """Stone Soup: its particle predictor, its updater and its systematic resampler."""

    def __init__(self, model: Model, size: int, seed: int) -> None:
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
        from stonesoup.predictor.particle import ParticlePredictor
        from stonesoup.resampler.particle import SystematicResampler
        from stonesoup.types.array import StateVectors
        from stonesoup.types.detection import Detection
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.state import ParticleState
        from stonesoup.updater.particle import ParticleUpdater

        np.random.seed(seed)  # noqa: NPY002 - Stone Soup draws from there

        class Measured(LinearGaussian):  # type: ignore[misc, unused-ignore]
            def logpdf(self, *arguments: Any, **settings: Any) -> Any:
                found["log"] = super().logpdf(*arguments, **settings)
                return found["log"]

        self.found: dict[str, Floats] = {}
        found = self.found
        moving = CombinedLinearGaussianTransitionModel([ConstantVelocity(model.diffusion)] * 2)
        measured = Measured(ndim_state=4, mapping=(0, 2), noise_covar=model.measured_sd**2 * np.eye(2))
        self.predictor = ParticlePredictor(moving)
        self.updater = ParticleUpdater(measured, SystematicResampler())
        self.detection = Detection
        self.hypothesis = SingleHypothesis
        self.now = datetime(2000, 1, 1)
        normals = np.random.standard_normal((4, size))  # noqa: NPY002
        sd = np.array([0.0, model.start_sd, 0.0, model.start_sd])
        self.state = ParticleState(
            StateVectors(normals * sd[:, None]), weight=np.full(size, 1.0 / size), timestamp=self.now
        )

    def step(self, measured: Floats) -> None:
        self.now += timedelta(seconds=1)
        predicted = self.predictor.predict(self.state, timestamp=self.now)
        detection = self.detection(measured[:, None], timestamp=self.now)
        self.state = self.updater.update(self.hypothesis(predicted, detection))

    def log_evidence(self) -> float:
        return log_mean(np.asarray(self.found["log"], dtype=np.float64))


def libraries() -> Mapping[str, Start]:
    """Name and version -> filters of the libraries that are installed."""
    known: dict[tuple[str, str], Start] = {
        ("stonesoup", "Stone Soup"): WithStoneSoup,
        ("particles", "particles"): WithParticles,
        ("filterpy", "filterpy"): WithFilterpy,
    }
    return {
        f"{name} {version(module)}": start
        for (module, name), start in known.items()
        if importlib.util.find_spec(module) is not None
    }


def answer() -> None:
    """Say what there is, then answer each request {filter, size, seed, model} on standard input."""
    found = libraries()
    print(json.dumps({"filters": list(found), "numpy": np.__version__}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        taken, log_evidence = run(
            found[asked["filter"]], Model(**asked["model"]), asked["size"], asked["seed"]
        )
        print(json.dumps({"seconds": taken, "log_evidence": log_evidence}), flush=True)


if __name__ == "__main__":
    answer()
