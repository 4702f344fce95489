"""How well `fit --motion` finds the noise that boxes were drawn with, and how often its intervals hold it.

    python benchmarks/fit_motion.py [--scenes 50] [--frames 400] [--first-seed 5000] [--motion modes]

Each scene is a trajectory from the prior, every box measured with an error of 2 px; the search begins
at six times the true sds, twice the factor and a third of the weight of a heavy tail, and three times the
durations of modes. Scenes have the seeds 5000, 5001, ...; nothing was chosen on them, but on 100 to 115.

The column `intervals` is the median error of a Gaussian as wide as the intervals: what the boxes allow. The
rows of `known_modes` are of durations by maximum likelihood from the modes themselves, which nobody observes.
"""

from __future__ import annotations

import argparse

import numpy as np

from bayesnet_track.belief.modes import make_modes
from bayesnet_track.engine.simulating import Simulation, simulate
from bayesnet_track.evaluate.motion.fit import ERRORS, QUANTILE, fit_motion
from bayesnet_track.evaluate.motion.parameters import parameters_of, with_value
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.read import read_graph

FIRST_SEED = 5000
ERROR_PX = 2.0
DRAWS = 20
"""Trajectories drawn, of which one is used: in each frame a whole number of them moves by the heavy tail."""
BOX = np.array([1e5, 1e5, 60.0, 40.0])
GRAPH = """\
bayesnet: 1
name: moves
targets:
  ball:
    nodes:
      ball: {belief: particles, NODE}
      gray: {parent: ball, agent: intensity}
"""
TURN = "{constant_velocity: {sd_velocity_px: 6, start_velocity_sd_px: 3}}"
MOTIONS = {
    "random_walk": "motion: {random_walk: {sd_px: {x: 3, y: 5}}}",
    "constant_velocity": "motion: {constant_velocity: {sd_velocity_px: 1.5, start_velocity_sd_px: 3}}",
    "damped_velocity": "motion: {damped_velocity: {sd_velocity_px: 2, start_velocity_sd_px: 3}}",
    "relative": "motion: {random_walk: {sd_box: {x: 0.1, y: 0.1}, sd_log: {scale: 0.03}}}",
    "heavy_tail": "motion: {random_walk: {sd_box: {x: 0.1, y: 0.1}, heavy_tail: {weight: 0.3, factor: 6}}}",
    "modes": "motion: {constant_velocity: {sd_velocity_px: 0.5, start_velocity_sd_px: 3}}, modes: {straight: "
    f"{{mean_frames: 20}}, turn: {{mean_frames: 10, motion: {TURN}}}}}",
    "short_modes": "motion: {constant_velocity: {sd_velocity_px: 0.5, start_velocity_sd_px: 3}}, modes: "
    f"{{straight: {{mean_frames: 6}}, turn: {{mean_frames: 4, motion: {TURN}}}}}",
}
KNOWN_MODES, KNOWN_SCENES = "known_modes", 2000
MEDIAN_ERROR = 0.6744897501960817
"""Of a Gaussian, in sds."""
AWAY = {"weight": 1 / 3, "factor": 2.0, "mean_frames": 3.0}
"""The search begins at the true value times this factor, and times 6 for sds."""


def main() -> None:
    """Print a row for each parameter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--motion", action="append", choices=[*MOTIONS, KNOWN_MODES], help="default: all")
    options = parser.parse_args()
    print(
        "motion", " " * 11, f"{'parameter':42}   true  median error  intervals  in 90 % interval  not known"
    )
    for name in options.motion or [*MOTIONS, KNOWN_MODES]:
        if name == KNOWN_MODES:
            lines = rows_of_known_modes(options.first_seed, options.frames)
        else:
            lines = rows(name, options.first_seed, options.scenes, options.frames)
        for line in lines:
            print(line, flush=True)


def rows(name: str, first_seed: int, scenes: int, frames: int) -> list[str]:
    """A row for each parameter of a motion."""
    plate = check(*read_graph(GRAPH.replace("NODE", MOTIONS[name]), "moves.yaml")).targets["ball"]
    root = plate.inference("ball")
    true = dict(parameters_of(root))
    far = root
    for path, value in true.items():
        far = with_value(far, path, AWAY.get(path[-1], 6.0) * value)
    found: dict[tuple[str, ...], list[tuple[float, bool, bool, float]]] = {}
    for seed in range(first_seed, first_seed + scenes):
        drawn = simulate(plate, {}, BOX, Simulation(frames, DRAWS, seed)).boxes[:, 0]
        boxes = drawn + np.random.default_rng(seed).normal(0, ERROR_PX, drawn.shape)
        for one in fit_motion(far, [boxes]).estimates:
            value = {**true, ERRORS[0]: ERROR_PX}.get(one.path)
            if value is not None:
                is_in = one.low <= value <= one.high
                allowed = MEDIAN_ERROR * (one.high - one.low) / (2.0 * QUANTILE) / one.value
                error = abs(one.value / value - 1)
                found.setdefault(one.path, []).append((error, is_in, one.is_known, allowed))
    values = {**true, ERRORS[0]: ERROR_PX}
    return [_row(name, path, values[path], each) for path, each in found.items()]


def _row(name: str, path: tuple[str, ...], value: float, each: list[tuple[float, bool, bool, float]]) -> str:
    errors, are_in, are_known, allowed = zip(*each, strict=True)
    return (
        f"{name:17}  {'.'.join(path[-4:]):46} {value:7g} {100 * float(np.median(errors)):11.1f} % "
        f"{100 * float(np.median(allowed)):8.1f} % {sum(are_in):10d} of {len(each):2d} "
        f"{len(each) - sum(are_known):9d}"
    )


def rows_of_known_modes(first_seed: int, frames: int) -> list[str]:
    """A row for each duration of `modes`, found from sequences of the modes themselves.

    The maximum-likelihood rates of a chain that is seen at every frame are the logarithm of its transition
    frequencies; of two modes, left with the frequencies p and q, -log(1 - p - q) p / (p + q).
    """
    root = check(*read_graph(GRAPH.replace("NODE", MOTIONS["modes"]), "m.yaml")).targets["ball"]
    modes = root.inference("ball").modes
    assert modes is not None
    true = np.array([float(mode.mean_frames or 0.0) for mode in modes.values()])
    moves, rng = make_modes(modes).chain.over(1.0), np.random.default_rng(first_seed)
    errors = []
    for _ in range(KNOWN_SCENES):
        counts, now = np.zeros((2, 2)), 0
        for uniform in rng.random(frames):
            after = int(uniform > moves[now, 0])
            counts[now, after] += 1
            now = after
        left = counts[[0, 1], [1, 0]] / np.maximum(counts.sum(axis=1), 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = -np.log(1.0 - left.sum()) * left / left.sum()
            errors.append(np.abs(1.0 / rates / true - 1.0))
    errors_of = np.nan_to_num(np.array(errors), nan=np.inf)
    return [
        f"{KNOWN_MODES:17}  {name + '.mean_frames':46} {value:7g} {100 * np.median(own):11.1f} %"
        for name, value, own in zip(modes, true, errors_of.T, strict=True)
    ]


if __name__ == "__main__":
    main()
