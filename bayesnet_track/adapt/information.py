"""Which agent to switch on or off by what it was worth: a discounted bandit over declared milliseconds.

Contributions are observed of active agents only, so that one that is off must be tried again to be known: the
upper confidence bound of discounted means (D-UCB; Garivier and Moulines, On upper-confidence bound policies
for switching bandit problems, 2011). It draws nothing, so that a run repeats exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from bayesnet_track.graph.spec import Adapt, Information


@dataclass(frozen=True)
class Worth:
    """What agents contributed, the past fading.

    Attributes:
        nats: agent -> sum of its contributions.
        frames: agent -> how many frames of it are remembered. Both sums count a frame exp(-age / memory).
    """

    nats: Mapping[str, float] = field(default_factory=dict)
    frames: Mapping[str, float] = field(default_factory=dict)

    def after(self, contribution: Mapping[str, float], memory: int) -> Worth:
        """With a frame more, in which the active agents contributed so many nats."""
        fade = math.exp(-1.0 / memory)
        nats = {agent: value * fade for agent, value in self.nats.items()}
        frames = {agent: value * fade for agent, value in self.frames.items()}
        for agent, value in contribution.items():
            nats[agent] = nats.get(agent, 0.0) + value
            frames[agent] = frames.get(agent, 0.0) + 1.0
        return Worth(nats, frames)

    def mean(self, agent: str) -> float | None:
        """Its remembered mean contribution, nats; None when it was never active."""
        frames = self.frames.get(agent, 0.0)
        return self.nats[agent] / frames if frames > 0.0 else None

    def hope(self, agent: str, exploration: float) -> float:
        """The mean and what its uncertainty lets hope for, nats; inf for an agent that was never active.

        mean + exploration sqrt(ln(1 + sum n) / n), n the remembered frames.
        """
        mean = self.mean(agent)
        if mean is None:
            return math.inf
        total = sum(self.frames.values())
        return mean + exploration * math.sqrt(math.log1p(total) / self.frames[agent])


def goes_by_worth(rules: Adapt) -> bool:
    """Whether rules choose agents by what they contributed."""
    on = rules.activate is not None and rules.activate.which == "information_per_ms"
    return on or (rules.deactivate is not None and rules.deactivate.drop == "min_information_per_ms")


def expected_per_ms(
    worth: Worth, agents: Iterable[str], costs_ms: Mapping[str, float], settings: Information
) -> dict[str, float]:
    """Agent -> information that may be expected of it per declared cost, nats per ms.

    >>> worth = Worth().after({"a": 0.4, "b": 0.6}, memory=100)
    >>> found = expected_per_ms(worth, "abc", {"a": 0.5, "b": 1.0, "c": 9.0}, Information(exploration=0))
    >>> round(found["a"], 9), round(found["b"], 9), found["c"]
    (0.8, 0.6, inf)
    """
    return {agent: worth.hope(agent, settings.exploration) / costs_ms[agent] for agent in agents}


def remembered_per_ms(worth: Worth, agents: Iterable[str], costs_ms: Mapping[str, float]) -> dict[str, float]:
    """Agent -> mean information that it gave per declared cost, nats per ms; for agents that are active."""
    return {agent: (worth.mean(agent) or 0.0) / costs_ms[agent] for agent in agents}
