"""Drift guard: a second, slow reference per agent says when the first one has learnt something else.

A reference that follows the estimate follows its errors too, and then likes what it has slid onto. The slow
reference starts as the same and follows the first one at a much smaller rate. Where the estimate is explained
by the first one and no longer by the slow one, the two have parted: the first one does not learn, and is
pulled back.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field

from bayesnet_track.graph.spec import Guard
from bayesnet_track.inference.asking import AgentUnavailable, Missing
from bayesnet_track.inference.learn import LearningInputs, blend_reference
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.switches import ReferenceGuarded
from bayesnet_track.observation.cue import FAULTS, Cue, Hypotheses, Reference, context_of, text_of
from bayesnet_track.observation.planes import region_of_boxes, shown


@dataclass(frozen=True, eq=False)
class SlowReferences:
    """Memory of the guard of one target.

    Attributes:
        slow: agent -> its slow reference.
        parted: agent whose references have parted -> for how many learning frames.
        frames: learning frames so far.
    """

    slow: Mapping[str, Reference] = field(default_factory=dict)
    parted: Mapping[str, int] = field(default_factory=dict)
    frames: int = 0


def watch(references: Mapping[str, Reference], looks: Set[str], rule: Guard | None) -> SlowReferences:
    """The guard of a target that starts: its slow references are the first ones.

    Only agents that score, and that know the target by its `looks`, are guarded: what another remembers, such
    as a speed, has to change as quickly as it does.
    """
    if rule is None:
        return SlowReferences()
    return SlowReferences({agent: one for agent, one in references.items() if agent in looks})


@dataclass(frozen=True, eq=False)
class DriftCheck:
    """Verdict of the guard in one frame.

    Attributes:
        gaps: agent that was checked -> log-likelihoods of the estimate by its own and by its slow reference.
        held: agents that must not learn in this frame.
        faults: agent -> what was wrong with it.
    """

    gaps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held: frozenset[str] = frozenset()
    faults: Mapping[str, str] = field(default_factory=dict)


def judge_nothing(watched: SlowReferences) -> DriftCheck:
    """Verdict of the guard in a frame in which nothing is compared."""
    return DriftCheck(held=frozenset(watched.parted))


def judge(
    lesson: LearningInputs,
    watched: SlowReferences,
    references: Mapping[str, Reference],
    rates: Mapping[str, float],
    rule: Guard | None,
) -> DriftCheck:
    """In every `rule.every`-th learning frame, compare what both references of an agent say of the estimate.

    They have parted where the slow one gives it a likelihood lower by more than `rule.apart_nats`; that holds
    until they are compared again. An agent that looks at a part is asked about the part's box.
    One that gives no answer for a reason outside of it is not compared; the lesson's availability has it.
    """
    availability = lesson.availability_for("guarding")
    learning = any(rate > 0.0 for rate in rates.values())
    if rule is None or not learning or (watched.frames + 1) % rule.every:
        return judge_nothing(watched)
    gaps: dict[str, tuple[float, float]] = {}
    faults: dict[str, str] = {}
    for agent, slow in watched.slow.items():
        cue = lesson.cues[agent]
        if rates.get(agent, 0.0) <= 0.0 or not isinstance(cue, Cue) or availability.misses(agent) is not None:
            continue
        further = {name: values.copy() for name, values in lesson.at.fields.items()}
        at = Hypotheses(lesson.box_of(agent)[None].copy(), further)
        try:
            planes = lesson.cache.planes(cue.needs, region_of_boxes(at.boxes, grow=context_of(cue)))
            both = shown(references[agent]), shown(slow)
            own, other = (float(cue.log_likelihood(planes, at, one)[0]) for one in both)
            gaps[agent] = own, other
        except AgentUnavailable as error:
            availability.note(agent, Missing(str(error)))
        except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
            faults[agent] = f"raised {type(error).__name__} while guarded: {text_of(error)}"
    parted = {agent for agent, (own, slow) in gaps.items() if own - slow > rule.apart_nats}
    unchecked = {agent for agent in watched.parted if agent not in gaps}
    return DriftCheck(gaps, frozenset(parted | unchecked), faults)


def guard(
    lesson: LearningInputs,
    watched: SlowReferences,
    judged: DriftCheck,
    references: Mapping[str, Reference],
    rates: Mapping[str, float],
    rule: Guard | None,
) -> tuple[dict[str, Reference], SlowReferences, dict[str, str]]:
    """Pull back what has parted; let the slow references follow the others.

    `references` are those after learning, in which agents that were held are as before. Rates per frame are
    made up for the frames since the last comparison. The last mapping says what was wrong with agents that
    failed. The references of one that gives no answer stay; the lesson's availability has it.
    """
    availability = lesson.availability_for("blending")
    guarded, slow, faults = dict(references), dict(watched.slow), dict(judged.faults)
    if rule is None or not any(rate > 0.0 for rate in rates.values()):
        return guarded, watched, faults
    parted = {agent: frames + 1 for agent, frames in watched.parted.items()}
    for agent in judged.gaps:
        if agent in judged.held:
            parted.setdefault(agent, 0)
            share, old, new = 1.0 - (1.0 - rule.pull) ** rule.every, references[agent], slow[agent]
        else:
            parted.pop(agent, None)
            share, old, new = 1.0 - (1.0 - rule.rate) ** rule.every, slow[agent], references[agent]
        mixed = availability.misses(agent) or blend_reference(lesson.cues[agent], old, new, share)
        if isinstance(mixed, Missing):
            availability.note(agent, mixed)
        elif isinstance(mixed, str):
            faults[agent] = mixed
        else:
            (guarded if agent in judged.held else slow)[agent] = mixed
    return guarded, SlowReferences(slow, parted, watched.frames + 1), faults


def changes(
    frame: int,
    target: str,
    before: SlowReferences,
    after: SlowReferences,
    judged: DriftCheck,
    rule: Guard | None,
) -> list[Event]:
    """The references that parted in this frame, and those that agree again."""
    events: list[Event] = []
    for agent, (own, slow) in judged.gaps.items():
        now = agent in after.parted
        if rule is not None and now != (agent in before.parted):
            lasted = 0 if now else before.parted[agent] + 1
            events.append(
                ReferenceGuarded(frame, target, agent, now, own, slow, rule.apart_nats, rule.pull, lasted)
            )
    return events
