"""A run's beliefs as a file for ArviZ: groups of arrays over draws, targets and frames, in netCDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.smoothing.backward import Move
from bayesnet_track.journal.atomic import PART
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import root
from bayesnet_track.numerics.resampling import systematic
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.runtime.lifetimes import kept_lifetimes, moves_of
from bayesnet_track.runtime.recording.beliefs import KeptBelief
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.resizing import Resizing

MOST_NUMBERS = 250_000_000
"""Of one group: 1 GB as float32."""

STATS = ("log_evidence", "surprise", "ess", "particles", "score", "ud_px2", "existence", "hidden")
"""Numbers per target and frame, as in ``frames.jsonl``."""

SAMPLED = ("chain", "draw", "target", "frame")
MARGINAL = (
    "draws of each frame's belief given the frames up to it; draws of the same number in two frames are no "
    "trajectory"
)


class ArvizError(ValueError):
    """A run that cannot be written for ArviZ, with the cure."""


@dataclass(frozen=True, eq=False)
class Groups:
    """Arrays of each group: variable -> values (draws, targets, frames), or (targets, frames), NaN if absent.

    Attributes:
        draws: per frame.
        targets: target ids.
        frames: frame numbers.
        sampled: group -> variable -> values over draws, targets, frames.
        observed: variable -> values over targets, frames.
    """

    draws: int
    targets: tuple[str, ...]
    frames: tuple[int, ...]
    sampled: dict[str, dict[str, NDArray[np.float32]]] = field(default_factory=dict)
    observed: dict[str, Floats] = field(default_factory=dict)

    def put(self, group: str, name: str, at: tuple[int, int], values: Floats) -> None:
        """Set the draws of a variable for one target and frame."""
        variables = self.sampled.setdefault(group, {})
        if name not in variables:
            shape = (self.draws, len(self.targets), len(self.frames))
            if (len(variables) + 1) * int(np.prod(shape)) > MOST_NUMBERS:
                raise ArvizError(
                    f"{shape[0]} draws of {shape[1]} targets in {shape[2]} frames are more than "
                    f"{MOST_NUMBERS:,} numbers in {group}; take fewer --draws"
                )
            variables[name] = np.full(shape, np.nan, dtype=np.float32)
        variables[name][:, at[0], at[1]] = values

    def observe(self, name: str, at: tuple[int, int], value: float) -> None:
        """Set what was measured of one target in one frame."""
        shape = len(self.targets), len(self.frames)
        self.observed.setdefault(name, np.full(shape, np.nan))[at] = value


def write_arviz(run: Run, path: Path, draws: int = 500, seed: int = 0) -> None:
    """Write a netCDF file that ArviZ 1 and xarray open.

    Args:
        run: a run whose beliefs were kept.
        path: file to write.
        draws: of each belief.
        seed: of the draws.

    Raises:
        ArvizError: xarray or h5netcdf is not installed, or there would be too many numbers.
        KeptBeliefsError: the run kept no beliefs, or has been smoothed.
        JournalError: beliefs.jsonl is damaged.
        OSError: the file cannot be written.

    ::

        write_arviz(open_run("runs/one"), Path("one.nc"))
        arviz.from_netcdf("one.nc")
    """
    xarray = _xarray()
    groups = beliefs_as_groups(run, draws, seed)
    part = path.with_name(path.name + PART)
    try:
        _tree(xarray, run, groups).to_netcdf(part, engine="h5netcdf")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def beliefs_as_groups(run: Run, draws: int, seed: int) -> Groups:
    """The beliefs as draws, with those a frame ahead, and what the agents said of them."""
    frames = sorted({line.frame for line in run.metrics} | run.seconds.keys())
    groups = Groups(draws, tuple(run.targets), tuple(frames))
    at_target = {target: number for number, target in enumerate(groups.targets)}
    at_frame = {frame: number for number, frame in enumerate(groups.frames)}
    streams, resizing = Streams(seed), Resizing.of(run.started)
    for lifetime in kept_lifetimes(run):
        moves: Sequence[Move | None] = [None, *moves_of(run, lifetime)]
        before: Floats | None = None
        for kept, move in zip(lifetime, moves, strict=True):
            at = at_target[kept.target], at_frame[kept.frame]
            rng = streams.of(kept.target, "", kept.frame, "arviz")
            states, chosen = draw_states(kept, draws, rng)
            fields = kept.posterior.fields
            _put_states(groups, "posterior", at, fields, states, resizing)
            if before is not None and move is not None:
                ahead = move.motion.propagate(before, move.dt, rng)
                _put_states(groups, "prior", at, fields, ahead, resizing)
            _put_agents(groups, at, kept, states, chosen, rng, resizing)
            before = states
    return groups


def draw_states(kept: KeptBelief, draws: int, rng: np.random.Generator) -> tuple[Floats, NDArray[np.intp]]:
    """(draws, D) states drawn from a kept belief, in any order, and (draws,) which particles they are."""
    posterior = kept.posterior
    if isinstance(posterior, GaussianPosterior):
        lower = root(posterior.covariance)
        states = posterior.mean + rng.standard_normal((draws, lower.shape[1])) @ lower.T
        states[:, 2:4] = np.maximum(states[:, 2:4], 1.0)
        return np.asarray(states), np.empty(0, dtype=np.intp)
    chosen = rng.permutation(systematic(posterior.weights.weights, draws, rng))
    return posterior.states[chosen], chosen


def _put_states(
    groups: Groups,
    group: str,
    at: tuple[int, int],
    fields: Sequence[str],
    states: Floats,
    resizing: Resizing,
) -> None:
    for name, values in zip(fields, states.T, strict=True):
        groups.put(group, name, at, resizing.field(name, values))


def _put_agents(
    groups: Groups,
    at: tuple[int, int],
    kept: KeptBelief,
    states: Floats,
    chosen: NDArray[np.intp],
    rng: np.random.Generator,
    resizing: Resizing,
) -> None:
    fields = kept.posterior.fields
    for agent, values in kept.heard.log_likelihoods.items():
        groups.put("log_likelihood", agent, at, values[chosen])
    for agent, one in kept.heard.measured.items():
        places = [fields.index(name) for name in one.fields]
        if agent not in kept.heard.log_likelihoods:
            groups.put("log_likelihood", agent, at, _log_likelihood(one, states[:, places]))
        lower = root(one.covariance)
        seen = states[:, places] + rng.standard_normal((len(states), lower.shape[1])) @ lower.T
        for name, values, value in zip(one.fields, seen.T, one.mean, strict=True):
            groups.put("posterior_predictive", f"{agent}_{name}", at, resizing.field(name, values))
            measured = float(resizing.field(name, np.asarray(value)))
            groups.observe(f"{agent}_{name}", at, measured)


def _log_likelihood(measured: Measurement, values: Floats) -> Floats:
    """(N,) 0 at the measured place itself, as of every agent; the floor is for particles alone."""
    away = values - measured.mean
    return np.asarray(-0.5 * np.sum(away * np.linalg.solve(measured.covariance, away.T).T, axis=1))


def _tree(xarray: Any, run: Run, groups: Groups) -> Any:
    """The groups as a DataTree."""
    coords = {"target": list(groups.targets), "frame": list(groups.frames)}
    over = {"chain": [0], "draw": np.arange(groups.draws), **coords}
    found = {
        f"/{name}": xarray.Dataset(
            {key: (SAMPLED, values[None]) for key, values in variables.items()}, over, {"draws": MARGINAL}
        )
        for name, variables in groups.sampled.items()
    }
    found["/sample_stats"] = xarray.Dataset(_per_frame(_statistics(run, groups)), coords)
    if groups.observed:
        found["/observed_data"] = xarray.Dataset(_per_frame(groups.observed), coords)
    times = {line.frame: line.time_s for line in run.metrics}
    constants = {
        "time_s": ("frame", [times.get(frame, np.nan) for frame in groups.frames]),
        "kind": ("target", [run.kinds[target] for target in groups.targets]),
        "width": ((), run.started.width),
        "height": ((), run.started.height),
    }
    found["/constant_data"] = xarray.Dataset(constants, coords)
    found["/"] = xarray.Dataset(
        attrs={
            "inference_library": "bayesnet_track",
            "graph": run.started.graph,
            "source": run.started.source,
            "seed": run.started.seed,
        }
    )
    return xarray.DataTree.from_dict(found)


def _per_frame(variables: Mapping[str, Floats]) -> dict[str, tuple[tuple[str, str], Floats]]:
    return {name: (("target", "frame"), values) for name, values in variables.items()}


def _statistics(run: Run, groups: Groups) -> dict[str, Floats]:
    shape = len(groups.targets), len(groups.frames)
    found = {name: np.full(shape, np.nan) for name in STATS}
    found["lost"] = np.full(shape, np.nan)
    at_target = {target: number for number, target in enumerate(groups.targets)}
    at_frame = {frame: number for number, frame in enumerate(groups.frames)}
    for line in run.metrics:
        at = at_target[line.target], at_frame[line.frame]
        for name in STATS:
            value = getattr(line, name)
            found[name][at] = np.nan if value is None else value
        found["lost"][at] = line.status == "lost"
    return {name: values for name, values in found.items() if not np.isnan(values).all()}


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
