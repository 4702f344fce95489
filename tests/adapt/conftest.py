"""Ways to run the measures on weighed hypotheses, and the rules on sequences of UD."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_columns import STATUSES, RuleColumns
from bayesnet_track.adapt.rule_inputs import GroupMeasures, Measures, RuleInputs
from bayesnet_track.adapt.rules import decide
from bayesnet_track.journal.net import Net, apply
from bayesnet_track.journal.target_net import TargetNet


class Drive:
    """What the rules did over a sequence of frames: decisions, and the net that each frame ran with."""

    def __init__(self, decisions, nets, memory):
        self.decisions, self.nets, self.memory = decisions, nets, memory

    def of(self, kind):
        """Decisions of a kind, in order."""
        return [decision for decision in self.decisions if isinstance(decision, kind)]

    def frames(self, kind, node=None):
        """Their frames, of one node or of all."""
        return [d.frame for d in self.of(kind) if node is None or d.node == node]


def columns_of(group):
    """The columns of targets that are judged together, from what the rules see of each."""
    head, hidden = group[0], [one.hidden for one in group]
    hiding = [None if one.hiding is None else one.hiding.hidden > one.hiding.level for one in group]
    ran = [one.call is not None and one.call.ran for one in group]
    asked = [
        bool(one.net.quarantined or one.missed or called) for one, called in zip(group, ran, strict=True)
    ]
    return RuleColumns(
        plate=head.plate,
        active=head.net.active,
        statuses=np.array([STATUSES.index(one.net.status) for one in group]),
        measures=GroupMeasures.of_each([one.measures for one in group]),
        see=group.__getitem__,
        adaptable=head.adaptable,
        hidden=np.array(hidden),
        score=None if head.score is None else np.array([one.score for one in group]),
        existence=None if head.existence is None else np.array([one.existence for one in group]),
        is_hidden=None if head.hiding is None else np.array(hiding),
        pending=np.array(asked),
    )


@pytest.fixture(scope="session")
def decide_all():
    """The decisions of one frame for targets that are judged together, and what the rules remember."""
    return lambda group, memory: decide(columns_of(group), memory)


def _decide_one(situation, memory):
    made, memory = decide(columns_of([situation]), memory)
    return made.get(0, ()), memory


@pytest.fixture(scope="session")
def decide_one():
    """The decisions of one frame for one target, and what the rules remember of it."""
    return _decide_one


def _at(contribution, agent, k):
    given = (contribution or {}).get(agent, 0.0)
    return given(k) if callable(given) else given


@pytest.fixture(scope="session")
def drive(fakes):
    """Run the rules of a net over a sequence of UD; frames count from 1."""

    def run(
        nodes, uds, *, active=None, net=None, kl=None, contribution=None, agent_uds=None, fits=None,
        areas=None, costs=None, adaptable=(), memory=None, insides=None, scores=None,
    ):  # fmt: skip
        plate, _ = fakes.plate(nodes)
        live = Net({"1": net or TargetNet("plate", frozenset(plate.agents if active is None else active))})
        memory = memory or RuleMemory.empty(plate)
        decisions, nets = [], []
        for k, given in enumerate(uds):
            now = live.targets["1"]
            ud = given(now.active) if callable(given) else given
            on = [agent for agent in plate.agents if agent in now.active]
            measures = Measures(
                ud_px2={node: ud[node] if isinstance(ud, dict) else float(ud) for node in plate.children},
                agent_ud_px2={
                    agent: float((agent_uds or {}).get(agent, [0.0] * len(uds))[k]) for agent in on
                },
                kl={agent: (kl or {}).get(agent, 0.0) for agent in on},
                contribution={agent: _at(contribution, agent, k) for agent in on},
                strength={},
                fit=1.0 if fits is None else fits[k],
                area_px2=400.0 if areas is None else areas[k],
                inside={} if insides is None else {("root", w): one for w, one in insides[k].items()},
            )
            situation = RuleInputs(
                k + 1,
                "1",
                plate,
                now,
                measures,
                costs or dict.fromkeys(plate.agents, 1.0),
                frozenset(adaptable),
                score=None if scores is None else scores[k],
            )
            made, memory = _decide_one(situation, memory)
            nets.append(now)
            for decision in made:
                live = apply(live, decision)
            decisions += made
        return Drive(decisions, nets, memory)

    return run
