"""The most probable trajectory through a filtered sequence of weighted hypotheses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.smoothing.backward import Move, heaviest
from bayesnet_track.numerics.arrays import Floats


def most_probable_trajectory(
    filtered: Sequence[ParticleSet], moves: Sequence[Move], on_grid: bool = False
) -> Floats:
    """(T, D) the hypotheses, one a frame, that maximise p(x_1) prod p(x_t | x_t-1) p(y_t | x_t).

    Viterbi's algorithm over the hypotheses (Godsill, Doucet and West 2001). Particles that were drawn from
    the prediction have weights in proportion to p(y_t | x_t); cells of a grid hold the prediction, too, which
    is divided out. Where the motion reaches no hypothesis, as after a reset, a new trajectory begins.

    Args:
        filtered: T beliefs, in order.
        moves: T - 1, from each to the next.
        on_grid: whether the weights hold the prediction.

    Raises:
        ValueError: `moves` are not one fewer than `filtered`.
    """
    if len(moves) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} beliefs need {len(filtered) - 1} moves, not {len(moves)}")
    kept = [heaviest(belief) for belief in filtered]
    best, came = kept[0].weights.log, [np.zeros(len(kept[0]), dtype=np.intp)]
    for before, after, move in zip(kept[:-1], kept[1:], moves, strict=True):
        with np.errstate(over="ignore"):  # of states that are out of reach
            density = move.motion.log_density(after.states, before.states, move.dt)
        evidence = after.weights.log
        if on_grid:
            evidence = evidence - np.logaddexp.reduce(density + before.weights.log, axis=1)
        paths = density + best
        chosen = paths.argmax(axis=1)
        reached = paths[np.arange(len(paths)), chosen]
        if not np.isfinite(reached).any():
            reached, chosen = np.full(len(paths), best.max()), np.full(len(paths), int(best.argmax()))
        with np.errstate(invalid="ignore"):
            best = np.nan_to_num(evidence + reached, nan=-np.inf)
        came.append(chosen)
    at, states = int(best.argmax()), []
    for belief, sources in zip(reversed(kept), reversed(came), strict=True):
        states.append(belief.states[at])
        at = int(sources[at])
    return np.array(states[::-1])
