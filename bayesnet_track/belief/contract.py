"""The contract between a belief and the engine.

A belief is stepped by ``step(prior, motion, evaluate, streams)``. It proposes hypotheses and asks `evaluate`
for their evidence, as often as it likes within a frame; it knows nothing of the net behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.noise import Transition
from bayesnet_track.cue import Hypotheses

Floats = NDArray[np.float64]

BOX_FIELDS = ("x", "y", "w", "h")


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the net says of N hypotheses.

    Attributes:
        log_likelihood: (N,) of the whole net, finite or -inf; zeros when no agent is active.
        messages: node -> (N,) log-likelihood that it sent to its parent (agents and inference nodes).
        latent: latent node -> its own hypotheses, index-aligned with the root's.
        faults: agent -> what it raised or returned; it has no message then.
    """

    log_likelihood: Floats
    messages: Mapping[str, Floats] = field(default_factory=dict)
    latent: Mapping[str, Hypotheses] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)


Evaluate = Callable[[Hypotheses, Floats], Evidence]
"""(hypotheses, (N,) normalised prior log-weights) -> evidence. Pure: may be called again in a frame."""

Stream = Callable[[str], np.random.Generator]
"""purpose -> generator, for one target and frame."""


class Motion(Protocol):
    """How states move. A state is a row of fields: x, y, w, h, then the fields that the model adds."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns of a state, BOX_FIELDS first."""
        ...

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states for a target first seen in the centre box (4,)."""
        ...

    def propagate(self, states: Floats, dt: float, rng: np.random.Generator) -> Floats:
        """(N, D) states after `dt` frame intervals; widths and heights stay at least 1 px."""
        ...

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """(M, N) log p(new_m | old_n) over the fields that have noise."""
        ...

    def transition(self, old: Floats, dt: float) -> Transition:
        """p(new | old) in coordinates in which it is a mixture of diagonal Gaussians."""
        ...
