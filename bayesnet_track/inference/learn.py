"""Reference updates while UD is low (thesis eqs. 2.15-2.16), and slow references that guard them.

A reference that follows the estimate follows its errors too, and then likes what it has slid onto. The slow
reference starts as the same and follows the first one at a much smaller rate. Where the estimate is explained
by the first one and no longer by the slow one, the two have parted: the first one does not learn, and is
pulled back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from bayesnet_track.graph.spec import Guard
from bayesnet_track.inference.asking import (
    AgentUnavailable,
    Availability,
    Missing,
    TargetAvailability,
    Wait,
    check_reference,
    defer_faults,
    each_at_once,
    fault_of,
    is_elsewhere,
)
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.switches import ReferenceGuarded
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import LEAST_VISIBLE, shares_inside
from bayesnet_track.observation.cue import (
    ANGLE,
    FAULTS,
    AnyCue,
    Cue,
    Hypotheses,
    LocallyAdaptable,
    Reference,
    Turnable,
    context_of,
    text_of,
)
from bayesnet_track.observation.planes import PlaneCache, Planes, region_of_boxes, shown


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
    return SlowReferences({agent: reference for agent, reference in references.items() if agent in looks})


@dataclass(frozen=True, eq=False)
class GuardVerdict:
    """Verdict of the guard in one frame.

    Attributes:
        gaps: agent that was checked -> log-likelihoods of the estimate by its own and by its slow reference.
        held: agents that must not learn in this frame.
        faults: agent -> what was wrong with it.
    """

    gaps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held: frozenset[str] = frozenset()
    faults: Mapping[str, str] = field(default_factory=dict)


def judge_nothing(watched: SlowReferences) -> GuardVerdict:
    """Verdict of the guard in a frame in which nothing is compared."""
    return GuardVerdict(held=frozenset(watched.parted))


def judge(
    lesson: LearningInputs,
    watched: SlowReferences,
    references: Mapping[str, Reference],
    rates: Mapping[str, float],
    rule: Guard | None,
) -> GuardVerdict:
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
        copies = {name: values.copy() for name, values in lesson.at.fields.items()}
        hypotheses = Hypotheses(lesson.box_of(agent)[None].copy(), copies)
        try:
            planes = lesson.planes_of(agent, hypotheses.boxes)
            pair = shown(references[agent]), shown(slow)
            fit, slow_fit = (
                float(cue.log_likelihood(planes, hypotheses, reference)[0]) for reference in pair
            )
            gaps[agent] = fit, slow_fit
        except AgentUnavailable as error:
            availability.note(agent, Missing(str(error)))
        except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
            faults[agent] = f"raised {type(error).__name__} while guarded: {text_of(error)}"
    parted = {agent for agent, (fit, slow) in gaps.items() if fit - slow > rule.apart_nats}
    unchecked = {agent for agent in watched.parted if agent not in gaps}
    return GuardVerdict(gaps, frozenset(parted | unchecked), faults)


def guard(
    lesson: LearningInputs,
    watched: SlowReferences,
    judged: GuardVerdict,
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
            share, base, target = 1.0 - (1.0 - rule.pull) ** rule.every, references[agent], slow[agent]
        else:
            parted.pop(agent, None)
            share, base, target = 1.0 - (1.0 - rule.rate) ** rule.every, slow[agent], references[agent]
        mixed = availability.misses(agent) or blend_reference(lesson.cues[agent], base, target, share)
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
    previous: SlowReferences,
    current: SlowReferences,
    judged: GuardVerdict,
    rule: Guard | None,
) -> list[Event]:
    """The references that parted in this frame, and those that agree again."""
    events: list[Event] = []
    for agent, (fit, slow) in judged.gaps.items():
        is_parted = agent in current.parted
        if rule is not None and is_parted != (agent in previous.parted):
            lasted = 0 if is_parted else previous.parted[agent] + 1
            events.append(
                ReferenceGuarded(
                    frame, target, agent, is_parted, fit, slow, rule.apart_nats, rule.pull, lasted
                )
            )
    return events


@dataclass(frozen=True, eq=False)
class LearningInputs:
    """Inputs from which the agents of one target learn in one frame.

    Attributes:
        cues: agent -> implementation.
        cache: the planes of the frame.
        at: the estimate, one hypothesis.
        own_boxes: agent that looks at a part, or through one of several cameras -> its centre box (4,).
        cameras: agent that looks through one of several cameras -> which.
        availability: agents that give no answer for a reason outside of them.
        target: target id.
    """

    cues: Mapping[str, AnyCue]
    cache: PlaneCache
    at: Hypotheses
    own_boxes: Mapping[str, Floats] = field(default_factory=dict)
    availability: Availability = field(default_factory=Availability)
    target: str = ""
    cameras: Mapping[str, str] = field(default_factory=dict)

    def planes_of(self, agent: str, boxes: Floats) -> Planes:
        """The planes that an agent reads around boxes (N, 4)."""
        cue, cache = self.cues[agent], self.cache.of_camera(self.cameras.get(agent, ""))
        assert cache is not None  # an agent whose camera has no frame is not asked
        return cache.planes(cue.needs, region_of_boxes(boxes, grow=context_of(cue)))

    def sees(self, agent: str) -> bool:
        """True if the camera of an agent has a frame with most of the target in it."""
        cache = self.cache.of_camera(self.cameras.get(agent, ""))
        if cache is None:
            return False
        frame = cache.frames.current
        return bool(shares_inside(self.box_of(agent)[None], frame.width, frame.height)[0] >= LEAST_VISIBLE)

    def box_of(self, agent: str) -> Floats:
        """(4,) the centre box that the agent looks at."""
        box: Floats = self.own_boxes[agent] if agent in self.own_boxes else self.at.boxes[0]
        return box

    @property
    def angle(self) -> float:
        """The estimate's rotation, degrees; 0 for a motion without one."""
        return float(self.at.fields[ANGLE][0]) if ANGLE in self.at.fields else 0.0

    def availability_for(self, during: str) -> TargetAvailability:
        """Agents that give no answer when asked for one thing."""
        return self.availability.of_target(self.target, during)


def learn_first(lesson: LearningInputs, agents: Iterable[str]) -> tuple[dict[str, Reference], dict[str, str]]:
    """The first references of some agents, and what was wrong with those that failed.

    Agents that give no answer for a reason outside of them are in neither; the lesson's availability has
    them.
    """
    availability = lesson.availability_for("starting")
    learning = [agent for agent in agents if availability.misses(agent) is None]
    outcomes = dict(each_at_once(partial(_learn_ahead, lesson), partial(_learnt, lesson), learning))
    return _split_faults({agent: outcomes[agent] for agent in learning}, availability)


def blend_reference(
    cue: AnyCue, base: Reference, target: Reference, rate: float
) -> Reference | str | Missing:
    """A reference between `base` (rate 0) and `target` (rate 1), or what went wrong."""
    try:
        return check_reference(cue.blend(shown(base), shown(target), rate))
    except AgentUnavailable as error:
        return Missing(str(error))
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return f"raised {type(error).__name__} while blending: {text_of(error)}"


def adapt_reference(
    lesson: LearningInputs, agent: str, reference: Reference, attempt: int
) -> Reference | str | None:
    """The reference as an agent tunes it itself, or what went wrong.

    None when nothing is left to try, or the agent gives no answer, which the lesson's availability has then.
    """
    cue, availability = lesson.cues[agent], lesson.availability_for("adapting")
    assert isinstance(cue, LocallyAdaptable)
    if availability.misses(agent) is not None:
        return None
    try:
        tuned = cue.adapt(shown(reference), attempt)
        return None if tuned is None else check_reference(tuned)
    except AgentUnavailable as error:
        availability.note(agent, Missing(str(error)))
        return None
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return f"raised {type(error).__name__} while adapting: {text_of(error)}"


def blend_ahead(
    lesson: LearningInputs, agent: str, base: Reference, rate: float
) -> Wait[Reference | str | Missing]:
    """Ask a cue elsewhere to learn and blend: what waits for the reference, or for what went wrong."""
    cue: Any = lesson.cues[agent]

    def ask() -> Wait[Reference]:
        method, arguments = _to_learn(lesson, agent)
        wait: Wait[Reference] = cue.ask_ahead("blend", shown(base), getattr(cue, method)(*arguments), rate)
        return wait

    return partial(_collect, defer_faults(ask, FAULTS))


def _learnt(lesson: LearningInputs, agent: str) -> Reference | str | Missing:
    """Reference of what the cue sees in its box, or what went wrong."""
    try:
        method, arguments = _to_learn(lesson, agent)
        return check_reference(getattr(lesson.cues[agent], method)(*arguments))
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return fault_of(error, " while learning")


def _learn_ahead(lesson: LearningInputs, agent: str) -> Wait[Reference | str | Missing] | None:
    """Ask a cue elsewhere to learn: what waits for the outcome, as `_learnt` has it; None for one here."""
    cue: Any = lesson.cues[agent]
    if not is_elsewhere(cue):
        return None

    def ask() -> Wait[Reference]:
        method, arguments = _to_learn(lesson, agent)
        wait: Wait[Reference] = cue.ask_ahead(method, *arguments)
        return wait

    return partial(_collect, defer_faults(ask, FAULTS))


def _to_learn(lesson: LearningInputs, agent: str) -> tuple[str, tuple[Any, ...]]:
    """Method of the cue that learns, and its arguments."""
    cue, box, angle = lesson.cues[agent], lesson.box_of(agent), lesson.angle
    planes = lesson.planes_of(agent, box[None, :])
    if angle != 0.0 and isinstance(cue, Turnable):
        return "learn_turned", (planes, box.copy(), angle)
    return "learn", (planes, box.copy())


def _collect(wait: Wait[Reference]) -> Reference | str | Missing:
    try:
        return check_reference(wait())
    except FAULTS as error:
        return fault_of(error, " while learning")


def _split_faults(
    outcomes: Mapping[str, Reference | str | Missing], availability: TargetAvailability
) -> tuple[dict[str, Reference], dict[str, str]]:
    references: dict[str, Reference] = {}
    faults: dict[str, str] = {}
    for agent, outcome in outcomes.items():
        if isinstance(outcome, Missing):
            availability.note(agent, outcome)
        elif isinstance(outcome, str):
            faults[agent] = outcome
        else:
            references[agent] = outcome
    return references, faults
