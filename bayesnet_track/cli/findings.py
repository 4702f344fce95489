"""Findings in the files of a run, each a measure against a level, and the remedies of each symptom."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.blocks import Course
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.numerics.arrays import Floats

FEW_FRAMES = 10
"""Below so many frames of a target nothing is said of it."""
FEW_P_VALUES = 30
"""Below so many measurements of an agent nothing is said of how well they were predicted."""
FEWEST = 3
"""A belief that rests on fewer hypotheses, in half of the frames, is a point."""


@dataclass(frozen=True)
class Finding:
    """Something that was measured and is beyond its level.

    Attributes:
        target: whom it is about.
        what: the measure, its value and the level, in words.
        remedy: name of the row in `remedies`; None where no key is known to help.
        agent: the agent that it is about, or None.
        frame: a frame in which to look, or None.
        measure: what was measured; findings of several targets with the same measure are alike.
        settings: changes of the graph that are worth a try, each of them one or more `PATH=VALUE`.
    """

    target: str
    what: str
    remedy: str | None
    agent: str | None = None
    frame: int | None = None
    measure: str = ""
    settings: tuple[tuple[str, ...], ...] = ()


COLUMNS = (
    *("status", "active", "ess", "particles", "log_evidence", "learn_rate"),
    *("features/", "kl/", "contribution/", "p_values/"),
)
"""What the checks read of a run."""


def find(course: Course, switches: int = 0) -> Iterator[Finding]:
    """Find what stands out in the course of one target, with its `COLUMNS`, without its first frame.

    `switches` is how many times an agent of its net was switched on or off.
    """
    later = course.part(1, len(course))
    if len(later) < FEW_FRAMES:
        return
    for check in CHECKS:
        yield from (replace(finding, measure=check.__name__.strip("_")) for finding in check(later))
    yield from _switching(later, switches)


def find_failures(target: str, failures: Sequence[Quarantined]) -> Iterator[Finding]:
    """A finding per agent of a target that failed, however short the run."""
    for agent in dict.fromkeys(event.node for event in failures):
        events = [event for event in failures if event.node == agent]
        times = "once" if len(events) == 1 else f"{len(events)} times"
        text = f"{agent} failed {times}, first in frame {events[0].frame}: {events[0].reason}"
        yield Finding(target, text, None, agent, events[0].frame, "failed")


def until_lost(course: Course) -> Course:
    """The course without the last stretch in which the target is lost: a target that leaves ends so."""
    visible = np.flatnonzero(~course.is_gone)
    return course.part(0, int(visible[-1]) + 1 if len(visible) else 0)


def _effective(course: Course) -> Iterator[Finding]:
    ess = course.numbers("ess")
    counts = ess[course.numbers("particles") > 20]
    if len(counts) and np.median(counts) < FEWEST:
        worst = int(course.frame[ess.argmin()])
        text = f"the effective number of hypotheses is {np.median(counts):.1f} (median; below {FEWEST})"
        yield Finding(course.target, text, "sharp", _loudest(course), worst)


def _doubt(course: Course) -> Iterator[Finding]:
    from bayesnet_track.graph.settings.scores import CONFIDENCE, FEATURES

    is_doubtful = course.is_text("status", ("uncertain",))
    count = int(is_doubtful.sum())
    if count <= len(course) // 10:
        return
    features = {
        name: (is_there[is_doubtful], numbers[is_doubtful])
        for name, (is_there, numbers) in course.by_name("features").items()
        if is_there[is_doubtful].any()
    }
    # Only a look-alike in reach bounds the score by exactly one half.
    lookalikes = int((features["most"][1] == 0.5).sum()) if "most" in features else 0
    decided = _decided(course, is_doubtful)
    text = f"uncertain in {count} of {len(course)} frames, decided in frame {decided}"
    if 2 * lookalikes >= count:
        text += f", in {lookalikes} of them because of a look-alike"
        yield Finding(course.target, text, "alike", frame=decided)
        return
    if "log_fit" in features:
        is_there, numbers = features["log_fit"]
        fit = exp(np.median(numbers[is_there]))
        text += f"; the best box has {fit:.2g} of the likelihood of a perfect match (median)"
    extra_names = sorted(features.keys() - {*FEATURES, "most"})
    medians = {name: float(np.median(np.where(*features[name], 0.0))) for name in extra_names}
    verifiers = [name for name in medians if not name.startswith(CONFIDENCE)]
    if verifiers:
        worst = min(verifiers, key=lambda name: medians[name])
        text += f"; by the verifier {worst} it has {exp(medians[worst]):.2g}"
    for name in (name for name in medians if name.startswith(CONFIDENCE)):
        sure = 1.0 / (1.0 + exp(-medians[name]))
        text += f"; {name.removeprefix(CONFIDENCE)} is sure of it to {sure:.0%} (median)"
    yield Finding(course.target, text, None, frame=decided)


def _unforeseen(course: Course) -> Iterator[Finding]:
    """Evidence is compared among frames with the same agents: one more agent lowers it."""
    evidence, groups = course.numbers("log_evidence"), course.block.codes("active")
    is_poor = np.zeros(len(course), dtype=bool)
    for group in np.unique(groups).tolist():
        same = groups == group
        is_poor[same] = _is_far_below(evidence[same])
    count = int(is_poor.sum())
    if 0 < count <= len(course) // 5:
        first = int(course.frame[is_poor.argmax()])
        text = (
            f"in {count} of {len(course)} frames the evidence is far below that of other frames, "
            f"first in frame {first}"
        )
        yield Finding(course.target, text, "bursts", frame=first)


def _is_far_below(values: Floats) -> NDArray[np.bool_]:
    if len(values) < FEW_FRAMES:
        return np.zeros(len(values), dtype=bool)
    median = np.median(values)
    spread = float(np.median(np.abs(values - median)))
    return np.asarray(values < median - max(8 * spread, 3.0))


def _contradiction(course: Course) -> Iterator[Finding]:
    divergences = course.by_name("kl")
    beside = sum(is_there.astype(np.int64) for is_there, _ in divergences.values())
    for agent, (is_there, numbers) in divergences.items():
        values = numbers[is_there & (beside > 1)]
        if len(values) >= FEW_FRAMES and np.median(values) > 4.0:
            text = f"{agent} contradicts the belief: KL {np.median(values):.1f} nats (median; above 4)"
            yield Finding(course.target, text, "sharp", agent)


def _predicted(course: Course) -> Iterator[Finding]:
    """p-values are uniform where measurements are as the motion and the agent's error say."""
    for agent, (is_there, numbers) in course.by_name("p_values").items():
        count = int(is_there.sum())
        if count < FEW_P_VALUES:
            continue
        outliers = course.frame[is_there & (numbers < 0.05)]
        median = np.median(numbers[is_there])
        if len(outliers) > 0.15 * count:
            text = (
                f"{agent} measures outside of the predicted 95 % in {len(outliers)} of {count} frames, first "
                f"in frame {outliers[0]} (expected 5 %; above 15 %)"
            )
            yield Finding(course.target, text, "narrow", agent, int(outliers[0]))
        elif median > 0.8:
            text = (
                f"{agent} measures closer to the prediction than predicted: p-value {median:.2f} (median; "
                "above 0.8, expected 0.5)"
            )
            yield Finding(course.target, text, "wide", agent)


def _lost(course: Course) -> Iterator[Finding]:
    is_lost = course.is_text("status", ("lost",))
    if not is_lost.any():
        return
    decided = _decided(course, is_lost)
    text = f"lost in {is_lost.sum()} of {len(course)} frames, decided in frame {decided}"
    yield Finding(course.target, text, "gone" if course.is_gone[-1] else None, frame=decided)


def _decided(course: Course, rows: NDArray[np.bool_]) -> int:
    """The frame in which the status of the first of some rows was decided, as `log` has it: it applies from
    the next one."""
    place = int(rows.argmax())
    return int(course.frame[place - 1] if place else course.frame[0] - 1)


def _learning(course: Course) -> Iterator[Finding]:
    learnt = int((course.numbers("learn_rate") > 0).sum())
    if learnt < len(course) // 10:
        text = f"references learned in {learnt} of {len(course)} frames only (below 10 %)"
        yield Finding(course.target, text, "stale")


def _switching(course: Course, switches: int) -> Iterator[Finding]:
    if switches > len(course) // 4:
        text = f"agents are switched {switches} times in {len(course)} frames (above once in four)"
        yield Finding(course.target, text, "flicker", measure="switching")


def _loudest(course: Course) -> str | None:
    """The agent with the largest contribution, on average."""
    totals = {
        agent: float(numbers[is_there].sum())
        for agent, (is_there, numbers) in course.by_name("contribution").items()
    }
    return max(totals, key=lambda agent: totals[agent], default=None)


CHECKS: Sequence[Callable[[Course], Iterator[Finding]]] = (
    _lost,
    _doubt,
    _effective,
    _unforeseen,
    _contradiction,
    _predicted,
    _learning,
)


ROOT, MOTION, AGENT = "ROOT", "MOTION", "AGENT"
"""What stands for the root node, its motion model and an agent in a key."""


@dataclass(frozen=True)
class Remedy:
    """One row.

    Attributes:
        symptom: what is seen.
        command: arguments of the command that shows it in the run directory RUN.
        key: path of a key in the graph, as `--set` takes it; ROOT, MOTION and AGENT stand for names.
        value: a value that is worth a try, as YAML.
        why: what it does, and what it costs.
    """

    symptom: str
    command: str
    key: str
    value: str
    why: str

    def setting(self, names: Mapping[str, str] = MappingProxyType({})) -> str:
        """`PATH=VALUE` with the names of a graph."""
        return f"{self.path(names)}={self.value}"

    def path(self, names: Mapping[str, str]) -> str:
        """The key with the names of a graph."""
        return ".".join(names.get(part, part) for part in self.key.split("."))


REMEDIES: Mapping[str, Remedy] = MappingProxyType(
    {
        "too_slow": Remedy(
            "it is lost at the first fast movement",
            "log RUN --kind status_changed",
            "ROOT.motion.MOTION.sd_box",
            "{x: 0.2, y: 0.2}",
            "hypotheses spread further between frames; neighbours come into reach, too",
        ),
        "bursts": Remedy(
            "it is lost when the target or the camera jerks, and follows well otherwise",
            "report RUN",
            "ROOT.motion.MOTION.heavy_tail",
            "{weight: 0.5, factor: 8}",
            "half of the hypotheses spread eight times as far; the others stay precise",
        ),
        "size": Remedy(
            "the box keeps its size while the target grows or shrinks",
            "report RUN",
            "ROOT.motion.MOTION.sd_log.scale",
            "0.1",
            "the size may change by a tenth per frame; needs an agent that sees size, such as a filter",
        ),
        "few_hypotheses": Remedy(
            "the box jitters, and another seed gives another result",
            "diagnose RUN",
            "ROOT.belief.particles.size",
            "1000",
            "more hypotheses; the time of agents grows with their number",
        ),
        "sharp": Remedy(
            "a few hypotheses hold nearly all of the weight",
            "diagnose RUN",
            "AGENT.agent.CUE.floor",
            "0.01",
            "one agent cannot rule out a box alone any more",
        ),
        "drift": Remedy(
            "the box slides onto the background over many frames",
            "log RUN --why N",
            "AGENT.learn_rate_max",
            "0.005",
            "the reference of this agent changes more slowly, and so learns fewer errors",
        ),
        "guard": Remedy(
            "it drifts although learning is slow",
            "log RUN --kind reference_guarded",
            "ROOT.learn.guard",
            "{rate: 0.002}",
            "a second, slow reference stops the first when the two diverge",
        ),
        "stale": Remedy(
            "the target changes its appearance, and references become outdated",
            "log RUN --why N",
            "ROOT.learn.below",
            "{ud_box: 0.4}",
            "references learn while the belief is wider, too",
        ),
        "gone": Remedy(
            "it does not find the target again after an occlusion",
            "log RUN --target 1",
            "ROOT.motion.MOTION.relocalize.share",
            "0.2",
            "a larger share of the hypotheses searches the frame while the belief is uncertain",
        ),
        "look_alike": Remedy(
            "it follows something that looks the same, and is certain",
            "log RUN --kind distractor_seen",
            "ROOT.distractors.within_nats",
            "6",
            "more look-alikes limit the score; an agent that distinguishes them (motion, stereo) helps more",
        ),
        "alike": Remedy(
            "it is uncertain because of a look-alike that never comes close",
            "log RUN --kind distractor_seen",
            "ROOT.distractors.frames",
            "8",
            "only look-alikes that stay so long raise doubt; an agent that distinguishes them helps more",
        ),
        "false_alarm": Remedy(
            "the box is right but reported as lost",
            "log RUN --kind status_changed",
            "ROOT.lost.score_below",
            "0.1",
            "lost at a lower score; where the graph has no score: lower `lost.fit_below`",
        ),
        "unreported": Remedy(
            "the box is wrong and the status is tracking",
            "score RUN --truth FILE",
            "ROOT.lost.score_below",
            "0.4",
            "lost at a higher score; `fit GRAPH --what score,lost` finds the value from your videos",
        ),
        "late": Remedy(
            "an agent is switched on only after the box is wrong",
            "log RUN --kind activated",
            "ROOT.adapt.activate.above",
            "{ud_px2: 110}",
            "agents are switched on earlier, and are on longer",
        ),
        "flicker": Remedy(
            "agents are switched on and off all the time",
            "log RUN --kind deactivated",
            "ROOT.adapt.deactivate.frames",
            "10",
            "an agent is switched off only after ten frames below the threshold",
        ),
        "regions": Remedy(
            "true centres lie outside the 90 % region too often",
            "score RUN --truth FILE",
            "ROOT.localization_error.sd_box",
            "0.02",
            "wider regions; `fit GRAPH --what localization_error` finds the value from your videos",
        ),
        "narrow": Remedy(
            "an agent measures far from where the target was predicted",
            "log RUN --why N",
            "ROOT.motion.MOTION.sd_px",
            "{x: 4, y: 4}",
            "more motion is expected; `fit GRAPH --motion` finds the value from boxes",
        ),
        "wide": Remedy(
            "an agent measures closer to the prediction than its error and the motion model predict",
            "log RUN --why N",
            "ROOT.motion.MOTION.sd_px",
            "{x: 0.5, y: 0.5}",
            "less motion is expected, so that errors of agents move the box less; `fit GRAPH --motion` finds "
            "the value from boxes",
        ),
        "slow": Remedy(
            "it takes too long per frame",
            "report RUN",
            "ROOT.belief.particles.size",
            "200",
            "fewer hypotheses; or `run --budget-ms` switches off the agents with the least "
            "information per millisecond",
        ),
    }
)
"""Name -> row, in the order in which they are tried."""
