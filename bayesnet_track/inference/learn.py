"""Reference updates: references move toward the estimate while UD is low (thesis eqs. 2.15-2.16)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bayesnet_track.adapt.conditions import read_level
from bayesnet_track.graph.spec import Learn
from bayesnet_track.inference.absent import Missing, Roll
from bayesnet_track.inference.executor import (
    AgentUnavailable,
    Executor,
    Halves,
    Serial,
    asked,
    each_at_once,
    is_elsewhere,
)
from bayesnet_track.observation.cue import AnyCue, Floats, LocallyAdaptable, Reference, Turnable, context_of
from bayesnet_track.observation.guests import FAULTS, text_of
from bayesnet_track.observation.planes import PlaneCache, region_of_boxes
from bayesnet_track.observation.shared import sealed, shown

NO_PARTS: Mapping[str, Floats] = {}
SERIAL = Serial()


def learning_rate(rule: Learn | None, ud_px2: float, area_px2: float, quiet_px2: float | None) -> float:
    """Share of the largest rate at this UD: (1 - tanh(2 (UD - theta) / theta)) / 2, 0 from theta upward.

    Thesis eq. 2.16. As printed it applies to every target whose UD is below theta and replaces more than half
    of the reference there, so `learn_references` multiplies it by a largest rate (corrected).

    >>> from bayesnet_track.graph.spec import Learn, Level
    >>> rule = Learn(below=Level(ud_px2=100.0))
    >>> round(learning_rate(rule, 50.0, 1.0, None), 4), learning_rate(rule, 100.0, 1.0, None)
    (0.8808, 0.0)
    """
    reading = None if rule is None else read_level(rule.below, ud_px2, area_px2, quiet_px2)
    if reading is None or reading.value >= reading.level:
        return 0.0
    return 0.5 * (1.0 - math.tanh(2.0 * (reading.value - reading.level) / reading.level))


def over_frames(rate: float, frames: int) -> float:
    """The rate that makes in one frame what `rate` makes in several: 1 - (1 - rate)^frames.

    >>> over_frames(0.5, 1), over_frames(0.5, 2)
    (0.5, 0.75)
    """
    return rate if frames == 1 else 1.0 - (1.0 - rate) ** frames


def learn_first(
    cues: Mapping[str, AnyCue],
    cache: PlaneCache,
    box: Floats,
    own: Mapping[str, Floats] = NO_PARTS,
    executor: Executor = SERIAL,
    roll: Roll | None = None,
) -> tuple[dict[str, Reference], dict[str, str]]:
    """Every agent's first reference, and what was wrong with those that failed.

    Agents that give no answer for a reason outside of them are in neither; `roll` has them. A reference is
    learnt from the centre box (4,) in `own`, of the part that the agent looks at, else from `box`.
    """
    roll = roll or Roll()
    learning = [agent for agent in cues if roll.misses(agent) is None]
    outcomes = each_at_once(
        executor, lambda agent: _learnt(cues[agent], cache, own.get(agent, box)), learning
    )
    return _sorted_out(dict(zip(learning, outcomes, strict=True)), roll)


def learn_references(
    references: Mapping[str, Reference],
    cues: Mapping[str, AnyCue],
    rates: Mapping[str, float],
    cache: PlaneCache,
    box: Floats,
    own: Mapping[str, Floats] = NO_PARTS,
    angle: float = 0.0,
    executor: Executor = SERIAL,
    roll: Roll | None = None,
) -> tuple[dict[str, Reference], dict[str, str]]:
    """The references of all agents, active or not, each moved by its rate toward what its box holds now.

    The box is that in `own`, of the part that the agent looks at, else `box`; the target in it is turned by
    `angle` degrees.

    Planes are computed on the estimate and as much around it as the agent asks for, unless the hypotheses'
    own region holds that. An agent that fails keeps its reference; the second mapping says what was wrong. So
    does one that gives no answer for a reason outside of it, which `roll` has.
    """
    roll = roll or Roll()
    learning = [agent for agent, rate in rates.items() if rate > 0.0 and roll.misses(agent) is None]
    outcomes = each_at_once(
        executor,
        lambda agent: _learnt(
            cues[agent], cache, own.get(agent, box), references[agent], rates[agent], angle
        ),
        learning,
    )
    moved, faults = _sorted_out(dict(zip(learning, outcomes, strict=True)), roll)
    return {**references, **moved}, faults


def blended(cue: AnyCue, old: Reference, new: Reference, rate: float) -> Reference | str | Missing:
    """A reference between `old` (rate 0) and `new` (rate 1), or what went wrong."""
    try:
        return _checked(cue.blend(shown(old), shown(new), rate))
    except AgentUnavailable as error:
        return Missing(str(error))
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return f"raised {type(error).__name__} while blending: {text_of(error)}"


def adapt_reference(
    cue: LocallyAdaptable, reference: Reference, attempt: int, agent: str = "", roll: Roll | None = None
) -> Reference | str | None:
    """The reference as an agent tunes it itself, or what went wrong.

    None when nothing is left to try, or the agent gives no answer, which `roll` has then.
    """
    roll = roll or Roll()
    if roll.misses(agent) is not None:
        return None
    try:
        tuned = cue.adapt(shown(reference), attempt)
        return None if tuned is None else _checked(tuned)
    except AgentUnavailable as error:
        roll.note(agent, Missing(str(error)))
        return None
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return f"raised {type(error).__name__} while adapting: {text_of(error)}"


def _learnt(
    cue: AnyCue,
    cache: PlaneCache,
    box: Floats,
    old: Reference | None = None,
    rate: float = 1.0,
    angle: float = 0.0,
) -> Halves[Reference | str | Missing]:
    """What the cue sees in the box, blended into the old reference; or what went wrong."""
    if not is_elsewhere(cue):
        yield False
    try:
        region = region_of_boxes(box[None, :], grow=context_of(cue))
        planes = cache.planes(cue.needs, region)
        is_turned = angle != 0.0 and isinstance(cue, Turnable)
        learn, turned = ("learn_turned", (angle,)) if is_turned else ("learn", ())
        if old is None:
            return _checked((yield from asked(cue, learn, planes, box.copy(), *turned)))
        seen = getattr(cue, learn)(planes, box.copy(), *turned)
        return _checked((yield from asked(cue, "blend", shown(old), seen, rate)))
    except AgentUnavailable as error:
        return Missing(str(error))
    except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
        return f"raised {type(error).__name__} while learning: {text_of(error)}"


def _checked(reference: Reference) -> Reference | str:
    for name, values in reference.items():
        array = np.asarray(values)
        if array.dtype.kind in "fc" and not np.isfinite(array).all():
            return f"made a reference whose {name!r} is not finite"
    return sealed(reference)


def _sorted_out(
    outcomes: Mapping[str, Reference | str | Missing], roll: Roll
) -> tuple[dict[str, Reference], dict[str, str]]:
    references: dict[str, Reference] = {}
    faults: dict[str, str] = {}
    for agent, outcome in outcomes.items():
        if isinstance(outcome, Missing):
            roll.note(agent, outcome)
        elif isinstance(outcome, str):
            faults[agent] = outcome
        else:
            references[agent] = outcome
    return references, faults
