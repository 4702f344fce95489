"""States (N, D) as others see them: hypotheses for cues, weighted states for what is measured of a step."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses


@dataclass(frozen=True, eq=False)
class WeightedStates:
    """Hypotheses (N, D) with their posterior weights (`belief.contract.Support`)."""

    states: Floats
    weights: LogWeights

    @property
    def boxes(self) -> Floats:
        """(N, 4) centre boxes."""
        return self.states[:, :4]


def hypotheses_of(states: Floats, fields: tuple[str, ...]) -> Hypotheses:
    """What cues see of `states` (N, D): the boxes, and the further fields by name."""
    return Hypotheses(states[:, :4], {name: states[:, k] for k, name in enumerate(fields) if k >= 4})
