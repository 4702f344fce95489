"""`self_check`: an agent whose own likelihood stays too wide stops itself."""

from __future__ import annotations

from pydantic import Field

from bayesnet_track.graph.rules.agent_rule import AgentMeasures, AgentRule
from bayesnet_track.graph.settings.adapt import Level
from bayesnet_track.graph.settings.base import FrameCount
from bayesnet_track.observation.cue import Floats


class SelfCheck(AgentRule):
    """An agent whose own likelihood is too wide first tries to sharpen it, then stops itself.

    After a self-stop the agent may be switched on again only after `rest` frames, by the `activate` rule
    above it (or when no agent is left); each further self-stop doubles its rest, so that it cannot oscillate.
    The last active agent never stops itself, and none does while the target is lost.
    """

    quantity = "own UD"
    relation = ">"
    adapts_first = True
    cause = "ud"

    above: Level = Field(description="level of UD")
    frames: FrameCount = Field(default=10, description="consecutive frames above the level before it stops")
    rest: FrameCount = Field(
        default=50, description="frames before it may be switched on again; doubles each time"
    )

    @property
    def level(self) -> Level:
        """The level of the agent's own UD."""
        return self.above

    def values(self, measures: AgentMeasures) -> Floats:
        """(T,) the agent's own UD, px^2."""
        return measures.measured("agent_ud_px2")
