"""A run's beliefs as draws: an xarray `Dataset`, and the netCDF file that ArviZ reads."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.journal.writer import PART
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import root
from bayesnet_track.numerics.resampling import systematic
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.smoothing import kept_lifetimes

MAX_NUMBERS = 250_000_000
"""Of the whole set: 1 GB as float32."""


class ArvizError(ValueError):
    """A run that cannot be written for ArviZ, with the cure."""


def write_arviz(run: Run, path: Path, draws: int = 500, seed: int = 0) -> None:
    """Write `beliefs_as_dataset` as the group `posterior` of a netCDF file, whole or not at all.

    Raises:
        ArvizError: xarray or h5netcdf is not installed, or there would be too many numbers.
        KeptBeliefsError: the run kept no beliefs, or has been smoothed.
        JournalError: beliefs.jsonl is damaged.
        OSError: the file cannot be written.

    ::

        write_arviz(open_run("runs/one"), Path("one.nc"))
        arviz.from_netcdf("one.nc").posterior
    """
    dataset, part = beliefs_as_dataset(run, draws, seed), path.with_name(path.name + PART)
    try:
        dataset.to_netcdf(part, group="posterior", engine="h5netcdf")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def beliefs_as_dataset(run: Run, draws: int = 500, seed: int = 0) -> Any:
    """Draws of each frame's belief, and the agents' log-likelihoods of them; errors as `write_arviz`.

    Over chain, draw, target, frame: the fields of the state, in px of the source, and `log_likelihood_AGENT`.
    Over target, frame: `measured_AGENT_FIELD`. NaN where the target, the agent or its measurement is absent.
    """
    xarray = _xarray()
    frames = {
        frame: n for n, frame in enumerate(sorted({line.frame for line in run.metrics} | {*run.seconds}))
    }
    targets = {target: n for n, target in enumerate(run.targets)}
    shape, streams, resizing = (1, draws, len(targets), len(frames)), Streams(seed), Resizing.of(run.started)
    variables: dict[str, NDArray[np.float32]] = {}

    def put(name: str, target: str, frame: int, values: Floats) -> None:
        if name not in variables:
            if (len(variables) + 1) * int(np.prod(shape)) > MAX_NUMBERS:
                raise ArvizError(
                    f"{draws} draws of {len(targets)} targets in {len(frames)} frames are more than "
                    f"{MAX_NUMBERS:,} numbers; take fewer draws ({setting('--draws', 'N')})"
                )
            variables[name] = np.full(shape if values.ndim else shape[2:], np.nan, dtype=np.float32)
        variables[name][..., targets[target], frames[frame]] = values

    for kept in (kept for lifetime in kept_lifetimes(run) for kept in lifetime):
        at = kept.target, kept.frame
        states, chosen = _draw(kept.posterior, draws, streams.of(*at[:1], "", kept.frame, "arviz"))
        for name, values in zip(kept.posterior.fields, states.T, strict=True):
            put(name, *at, resizing.field(name, values))
        for agent, likelihoods in kept.heard.log_likelihoods.items():
            put(f"log_likelihood_{agent}", *at, likelihoods[chosen])
        for agent, measurement in kept.heard.measured.items():
            for name, value in zip(measurement.fields, measurement.mean, strict=True):
                put(f"measured_{agent}_{name}", *at, resizing.field(name, np.asarray(value)))
    times = {line.frame: line.time_s for line in run.metrics}
    return xarray.Dataset(
        {name: (("chain", "draw", "target", "frame")[4 - v.ndim :], v) for name, v in variables.items()},
        {
            "chain": [0],
            "draw": np.arange(draws),
            "target": list(targets),
            "frame": list(frames),
            "kind": ("target", [run.kinds[target] for target in targets]),
            "time_s": ("frame", [times.get(frame, np.nan) for frame in frames]),
        },
        {"inference_library": "bayesnet_track", "graph": run.started.graph, "source": run.started.source},
    )


def _draw(
    posterior: ParticleSet | GaussianPosterior, draws: int, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.intp]]:
    """(draws, D) states in any order, and (draws,) which particles they are."""
    if isinstance(posterior, GaussianPosterior):
        lower = root(posterior.covariance)
        states = posterior.mean + rng.standard_normal((draws, lower.shape[1])) @ lower.T
        states[:, 2:4] = np.maximum(states[:, 2:4], 1.0)
        return states, np.empty(0, dtype=np.intp)
    chosen = rng.permutation(systematic(posterior.weights.weights, draws, rng))
    return posterior.states[chosen], chosen


def _xarray() -> Any:
    try:
        import_module("h5netcdf")
        import_module("h5py")
        return import_module("xarray")
    except ImportError as error:
        raise ArvizError(
            f"{error.name} is not installed; pip install 'bayesnet-track[arviz]' (h5py, which writes the "
            "file, has wheels up to Python 3.14; ArviZ 1, which reads it, needs Python 3.12)"
        ) from error
