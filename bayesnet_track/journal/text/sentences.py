"""Events as sentences, their targets by name, and a longer account of one frame."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isclose, log, tanh
from types import MappingProxyType
from typing import get_args

from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.events import runs
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.statuses import DistractorSeen, DoubtEnded, StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated, Scheduled, SelfStopped
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Switch
from bayesnet_track.journal.target_net import Cause, Concentration, FitCause, RuleCause, ScoreCause
from bayesnet_track.journal.text.wording import UNIT


def explain(event: Event, name_target: bool = False) -> str:
    """One sentence for an event.

    UD stands in the unit of its threshold, with px² beside it where that is another unit. "Would have" names
    the threshold, rounded away from the one that was set, at which the rule would not have fired.
    `name_target` says whose net it was, for runs of several targets.

    >>> from bayesnet_track.journal.target_net import Cause
    >>> from bayesnet_track.journal.events.switches import Activated
    >>> cause = Cause("ud_px2", 200.0, 212.4, 3, 212.4, 212.4, 1.0)
    >>> explain(Activated(29, "1", "motion", "square", cause))
    'frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at activate ≥ 213'
    """
    sentence = event.describe()
    if isinstance(event, runs.RunStarted | runs.RunEnded):
        return sentence
    target = getattr(event, "target", None)
    whose = f", target {target}" if name_target and target and f"target {target}" not in sentence else ""
    return f"frame {event.frame}{whose}: {sentence}"


_STARTS = re.compile(r"\btarget (\d+) starts as \w+, ")
_TARGET = re.compile(r"\btarget (\d+)\b")


def kinds_of(events: Iterable[Event]) -> dict[str, str]:
    """Target id -> its type, the name of its class of targets in the graph."""
    return {event.target: event.template for event in events if isinstance(event, TargetStarted | Returned)}


def name_targets(text: str, kinds: Mapping[str, str]) -> str:
    """The text with the type of each target in place of the word target, where it is known.

    >>> name_targets("frame 9: target 1 lost", {"1": "ball"})
    'frame 9: ball 1 lost'
    """

    def name(number: str) -> str:
        return f"{kinds.get(number, 'target')} {number}"

    text = _STARTS.sub(lambda match: f"{name(match[1])} starts, ", text)
    return _TARGET.sub(lambda match: name(match[1]), text)


def narrate(event: Event, kinds: Mapping[str, str], name_target: bool = False) -> str:
    """The sentence of an event, its targets by type and number."""
    return name_targets(explain(event, name_target), kinds)


ARROW = " → "
_PREVENTED = re.compile(r"; (?=would (?:not )?have |not at )")
_FRAME = re.compile(r"^frame \d+(?:, target [^:]*)?: ")


def split_sentence(sentence: str) -> tuple[str, str, str, str]:
    """The four pieces of a sentence: its frame, why, what changed, and what would have prevented it.

    Only the third is never empty.

    >>> split_sentence("frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at 213")
    ('frame 29: ', 'UD 212 px² > 200 for 3 frames', 'motion on', 'would have stayed off at 213')
    """
    prefix = _FRAME.match(sentence)
    frame = prefix[0] if prefix else ""
    described, *prevented = _PREVENTED.split(sentence[len(frame) :], maxsplit=1)
    why, arrow, change = described.partition(ARROW)
    return (frame, why, change, "".join(prevented)) if arrow else (frame, "", described, "".join(prevented))


__all__ = ["Filter", "explain", "has_several_targets", "why"]


def has_several_targets(events: Iterable[Event]) -> bool:
    """True when more than one target starts, so that sentences have to say whose net they are about."""
    return len({event.target for event in events if isinstance(event, TargetStarted)}) > 1


@dataclass(frozen=True)
class Filter:
    """Selection of the events to show; a part that is None lets all pass.

    Attributes:
        node: name of an agent or of the inference node whose rule fired.
        kind: name of an event in the file, such as activated.
        frames: first frame, and the frame before which to stop.
        target: id of a target.

    Raises:
        ValueError: no event is of that kind.
    """

    node: str | None = None
    kind: str | None = None
    frames: tuple[int, int] | None = None
    target: str | None = None

    def __post_init__(self) -> None:
        kinds = [event_name(kind) for kind in get_args(Event)]
        if self.kind is not None and self.kind not in kinds:
            matches = get_close_matches(self.kind, kinds, n=1)
            hint = f"; did you mean {matches[0]}?" if matches else ""
            raise ValueError(f"no event is called {self.kind!r}; there are {', '.join(kinds)}{hint}")

    def keeps(self, event: Event) -> bool:
        """True when the event passes every part."""
        if self.kind is not None and self.kind != event_name(type(event)):
            return False
        if self.target is not None and self.target != getattr(event, "target", None):
            return False
        if self.node is not None and self.node not in (
            getattr(event, "node", None),
            getattr(event, "governor", None),
            *getattr(event, "nodes", ()),
        ):
            return False
        if self.frames is None:
            return True
        frame = getattr(event, "frame", None)
        return frame is not None and self.frames[0] <= frame < self.frames[1]


def why(
    events: Iterable[Event],
    metrics: Iterable[FrameMetrics],
    frame: int,
    target: str | None = None,
    scores: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> str:
    """A longer account of one frame: estimate, UD, and each agent with its KL and the decision that set it.

    `target` is the only one that it is about. `scores` are the graph's: type of target -> feature -> its
    coefficient, and `bias`.

    Raises:
        ValueError: no line of `metrics` is of that frame, or of the target in it.
    """
    known_events, lines = list(events), list(metrics)
    selected = [line for line in lines if line.frame == frame and target in (None, line.target)]
    if not selected:
        frames = sorted({line.frame for line in lines})
        if frames and frames[0] <= frame <= frames[-1]:
            who = "no target is" if target is None else f"target {target} is not"
            raise ValueError(f"{who} live in frame {frame}")
        range_ = f"it has frames {frames[0]} to {frames[-1]}" if frames else "it has none"
        raise ValueError(f"frame {frame} is not in this run; {range_}")
    kinds = kinds_of(known_events)
    return "\n\n".join(
        _account(known_events, line, scores.get(kinds.get(line.target, ""), {})) for line in selected
    )


# ------------------------------------------------------------------------------------ one frame


def _account(events: Sequence[Event], line: FrameMetrics, slopes: Mapping[str, float]) -> str:
    x, y, w, h = line.centre_box
    quiet = "not yet measured" if line.quiet_px2 is None else f"{_ud(line.quiet_px2)} {line.ud_unit}"
    units = [line.ud_unit, *("px²" for _ in line.ud_nodes)]
    uds = [f"{node} {_ud(ud)} {unit}" for (node, ud), unit in zip(line.ud_nodes.items(), units, strict=False)]
    sample = f"{line.particles}, of which {line.ess:.0f} effective"
    rows = [
        f"frame {line.frame} at {line.time_s:.3f} s, target {line.target}: {line.status}, "
        f"score {line.score:.2f} ({'probability of being on target' if line.features else 'uncalibrated'})",
        f"  estimate   centre {x:.1f}, {y:.1f}, {w:.1f} x {h:.1f} px; "
        f"sd {', '.join(f'{value:.1f}' for value in line.sd)} px",
        f"  hypotheses {sample}; log evidence {line.log_evidence:.2f}",
        f"  UD         {', '.join(uds)}; "
        f"baseline {quiet}; learning at {100 * line.learn_rate:.0f} % of the full rate",
    ]
    if line.modes:
        rows.append(f"  modes      {_probabilities(line.modes, line.modes_predicted)}")
    rows += [
        f"  {name:<10} {_probabilities(probabilities, _values_of(line.category_predicted, name))}"
        for name, probabilities in line.categories.items()
    ]
    mine = [event for event in events if getattr(event, "target", None) == line.target]
    if line.features:
        rows.append(f"{_score(line, slopes)}{_limit(line, mine)}")
    for agent, p in line.p_values.items():
        rows.append(
            f"  predicted  {agent}: {100 * p:.3g} % of such measurements lie farther from the prediction"
        )
    if line.e_value is not None:
        rows.append(f"  e-value    {line.e_value:.3g} that the target is not held")
    earlier = [event for event in mine if getattr(event, "frame", 0) < line.frame or _is_start(event, line)]
    for agent in _agents(mine, line):
        rests = _is_on_call(agent, earlier) and agent not in line.active
        state = "rests" if rests else "on " if agent in line.active else "off"
        rows.append(f"  {agent:<10} {state}  {_measured(agent, line)}")
        rows.append(f"  {'':<10} {_set_by(agent, earlier)}")
    current = [event for event in events if getattr(event, "frame", None) == line.frame]
    current = [event for event in current if getattr(event, "target", line.target) == line.target]
    rows += [
        f"  from here  {explain(event).partition(': ')[2]}" for event in current if not _is_start(event, line)
    ]
    levels = _levels(mine)
    rows += [f"  thresholds {', '.join(levels)}"] if levels else []
    return "\n".join(rows)


def _values_of(category: Mapping[str, float], name: str) -> dict[str, float]:
    return {key.partition("=")[2]: share for key, share in category.items() if key.startswith(f"{name}=")}


def _probabilities(posterior: Mapping[str, float], prior: Mapping[str, float]) -> str:
    """Each mode before the evidence, what the frame says of it in nats, the best one 0, and after it."""
    if not prior:
        return ", ".join(f"{mode} {p:.3g}" for mode, p in posterior.items())
    nats = {mode: log(p / prior[mode]) for mode, p in posterior.items()}
    highest = max(nats.values())
    return "; ".join(
        f"{mode} predicted {prior[mode]:.3g}, evidence {nats[mode] - highest:+.2f} nats, now {p:.3g}"
        for mode, p in posterior.items()
    )


def _score(line: FrameMetrics, slopes: Mapping[str, float]) -> str:
    """Terms of the score; without the graph's coefficients, what was measured for it."""
    if not slopes:
        texts = [f"{name} {value:.2f}" for name, value in sorted(line.features.items()) if name != "most"]
        return f"  features   {', '.join(texts)}; the coefficients are in the graph"
    weights = {name: slope for name, slope in slopes.items() if slope and name in line.features}
    terms = {name: slope * line.features[name] for name, slope in weights.items()}
    odds = slopes["bias"] + sum(terms.values())
    parts = [
        f"{name} {weights[name]:.3g} × {line.features[name]:.2f} = {term:.2f}" for name, term in terms.items()
    ]
    summed = ", ".join([f"bias {slopes['bias']:.3g}", *parts])
    return f"  score from {summed}; log odds {odds:.2f}, probability {0.5 + 0.5 * tanh(odds / 2):.2f}"


def _limit(line: FrameMetrics, mine: Iterable[Event]) -> str:
    """The limit of the score; empty if it has none."""
    limit = line.features.get("most", 1.0)
    if limit >= 1.0:
        return ""
    reason = "the best hypothesis fits badly"
    doubts = [
        event
        for event in mine
        if isinstance(event, DistractorSeen | DoubtEnded) and event.frame <= line.frame
    ]
    if line.hidden is not None and isclose(limit, 1.0 - line.hidden, abs_tol=1e-6):
        reason = f"the target is hidden with probability {line.hidden:.2f}"
    elif limit == 0.5 and doubts and isinstance(doubts[-1], DistractorSeen):
        reason = f"of the look-alike seen in frame {doubts[-1].frame}"
    return f"; at most {limit:.2f}, because {reason}"


def _is_start(event: Event, line: FrameMetrics) -> bool:
    return isinstance(event, TargetStarted) and event.target == line.target


def _agents(events: Sequence[Event], line: FrameMetrics) -> list[str]:
    """The agents heard of in the run, those of the start first."""
    initial = [name for event in events if isinstance(event, TargetStarted) for name in event.active]
    later = [event.node for event in events if isinstance(event, Switch)]
    return list(dict.fromkeys([*initial, *later, *line.active]))


def _measured(agent: str, line: FrameMetrics) -> str:
    if agent not in line.active:
        return "gave no evidence"
    if agent in line.silent:
        return "did not see the target"
    parts = [f"KL {line.kl[agent]:.2f}"] if agent in line.kl else []
    parts += [f"contribution {line.contribution[agent]:.2f} nats"] if agent in line.contribution else []
    parts += [f"its own UD {_ud(line.agent_ud_px2[agent])} px²"] if agent in line.agent_ud_px2 else []
    parts += [f"strength {line.strength[agent]:.2f} nats"] if agent in line.strength else []
    return ", ".join(parts) or "gave evidence"


def _set_by(agent: str, earlier: Sequence[Event]) -> str:
    """The last decision that switched the agent, as a sentence."""
    for event in reversed(earlier):
        if isinstance(event, TargetStarted):
            return (
                f"on since frame {event.frame}, the start" if agent in event.active else "off since the start"
            )
        if isinstance(event, Switch) and event.node == agent:
            return explain(event)
        if isinstance(event, Scheduled) and agent in event.nodes:
            return explain(event)
    return "not switched by any event"


def _is_on_call(agent: str, earlier: Sequence[Event]) -> bool:
    """True if the last decision about the agent is when it runs next."""
    for event in reversed(earlier):
        if isinstance(event, Switch) and event.node == agent:
            return False
        if isinstance(event, Scheduled) and agent in event.nodes:
            return True
    return False


def _levels(events: Sequence[Event]) -> list[str]:
    """The thresholds that fired anywhere in the run."""
    levels: dict[str, None] = {}
    for event in events:
        if isinstance(event, Scheduled):
            levels[f"{', '.join(event.nodes)} rests from an overlap of {event.agree:g}"] = None
        cause = getattr(event, "cause", None)
        if isinstance(cause, Concentration) and isinstance(event, Activated | Deactivated):
            switches = "activates unless" if isinstance(event, Activated) else "deactivates when"
            test = f"{cause.share:g} lies within {cause.within_box:g} box of the mode"
            levels[f"{event.governor} {switches} {test} (confidence {cause.confidence:g})"] = None
        if isinstance(cause, ScoreCause) and isinstance(event, StatusChanged):
            levels[f"{'below' if cause.fell else 'from'} a score of {cause.level:g} {event.status}"] = None
        if isinstance(cause, FitCause):
            levels[f"lost below a fit of {cause.level:g} (1: perfect)"] = None
        if isinstance(cause, RuleCause) and isinstance(event, SelfStopped):
            side = "above" if cause.relation == ">" else "below"
            levels[f"{event.node} stops itself {side} {cause.level:g}{cause.unit} ({cause.rule})"] = None
        if not isinstance(cause, Cause):
            continue
        level = f"{'a score of ' if cause.unit == 'score' else ''}{cause.level:g}{UNIT[cause.unit]}"
        match event:
            case Activated():
                levels[f"{event.governor} activates above {level}"] = None
            case Deactivated():
                levels[f"{event.governor} deactivates below {level}"] = None
            case SelfStopped():
                levels[f"{event.node} stops itself above {level}"] = None
            case StatusChanged():
                levels[f"lost above {level}"] = None
    return list(levels)


def _ud(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
