"""Findings in the files of a run, each a measure against a level, and the remedies of each symptom."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp
from statistics import median
from types import MappingProxyType

from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.metrics import FrameMetrics

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
    """

    target: str
    what: str
    remedy: str | None
    agent: str | None = None
    frame: int | None = None
    measure: str = ""


Lines = Sequence[FrameMetrics]


def find(lines: Lines, switches: int = 0) -> Iterator[Finding]:
    """What stands out in the lines of one target, in the order of frames, without its first frame.

    `switches` is how many times an agent of its net was switched on or off.
    """
    later = lines[1:]
    if len(later) < FEW_FRAMES:
        return
    for check in CHECKS:
        yield from (replace(one, measure=check.__name__.strip("_")) for one in check(later))
    yield from _switching(later, switches)


def find_failures(target: str, failures: Sequence[Quarantined]) -> Iterator[Finding]:
    """A finding per agent of a target that failed, however short the run."""
    for agent in dict.fromkeys(event.node for event in failures):
        own = [event for event in failures if event.node == agent]
        times = "once" if len(own) == 1 else f"{len(own)} times"
        what = f"{agent} failed {times}, first in frame {own[0].frame}: {own[0].reason}"
        yield Finding(target, what, None, agent, own[0].frame, "failed")


def until_lost(lines: Lines) -> Lines:
    """The lines without the last stretch in which the target is lost: a target that leaves ends so."""
    end = len(lines)
    while end and lines[end - 1].is_gone:
        end -= 1
    return lines[:end]


def _effective(lines: Lines) -> Iterator[Finding]:
    counts = [line.ess for line in lines if line.particles > 20]
    if counts and median(counts) < FEWEST:
        worst = min(lines, key=lambda line: line.ess)
        what = f"the effective number of hypotheses is {median(counts):.1f} (median; below {FEWEST})"
        yield Finding(lines[0].target, what, "sharp", _loudest(lines), worst.frame)


def _doubt(lines: Lines) -> Iterator[Finding]:
    from bayesnet_track.graph.settings.scores import CONFIDENCE, FEATURES

    doubtful = [line for line in lines if line.status == "uncertain"]
    if len(doubtful) <= len(lines) // 10:
        return
    # Only a look-alike in reach bounds the score by exactly one half.
    alike = sum(line.features.get("most") == 0.5 for line in doubtful)
    decided = _decided(lines, doubtful[0])
    what = f"uncertain in {len(doubtful)} of {len(lines)} frames, decided in frame {decided}"
    if 2 * alike >= len(doubtful):
        what += f", in {alike} of them because of a look-alike"
        yield Finding(lines[0].target, what, "alike", frame=decided)
        return
    fits = [line.features["log_fit"] for line in doubtful if "log_fit" in line.features]
    if fits:
        what += f"; the best box has {exp(median(fits)):.2g} of the likelihood of a perfect match (median)"
    further = sorted({name for line in doubtful for name in line.features} - {*FEATURES, "most"})
    said = {name: median(line.features.get(name, 0.0) for line in doubtful) for name in further}
    verifiers = [name for name in said if not name.startswith(CONFIDENCE)]
    if verifiers:
        worst = min(verifiers, key=lambda name: said[name])
        what += f"; by the verifier {worst} it has {exp(said[worst]):.2g}"
    for name in (name for name in said if name.startswith(CONFIDENCE)):
        sure = 1.0 / (1.0 + exp(-said[name]))
        what += f"; {name.removeprefix(CONFIDENCE)} is sure of it to {sure:.0%} (median)"
    yield Finding(lines[0].target, what, None, frame=decided)


def _unforeseen(lines: Lines) -> Iterator[Finding]:
    """Evidence is compared among frames with the same agents: one more agent lowers it."""
    by_agents: dict[tuple[str, ...], list[FrameMetrics]] = {}
    for line in lines:
        by_agents.setdefault(line.active, []).append(line)
    poor = [line for same in by_agents.values() for line in _far_below(same)]
    if poor and len(poor) <= len(lines) // 5:
        first = min(line.frame for line in poor)
        what = (
            f"in {len(poor)} of {len(lines)} frames the evidence is far below that of other frames, "
            f"first in frame {first}"
        )
        yield Finding(lines[0].target, what, "bursts", frame=first)


def _far_below(lines: Lines) -> Lines:
    if len(lines) < FEW_FRAMES:
        return []
    values = [line.log_evidence for line in lines]
    usual = median(values)
    spread = median(abs(value - usual) for value in values)
    return [line for line in lines if line.log_evidence < usual - max(8 * spread, 3.0)]


def _contradiction(lines: Lines) -> Iterator[Finding]:
    agents = dict.fromkeys(agent for line in lines for agent in line.kl)
    for agent in agents:
        values = [line.kl[agent] for line in lines if agent in line.kl and len(line.kl) > 1]
        if len(values) >= FEW_FRAMES and median(values) > 4.0:
            what = f"{agent} contradicts the belief: KL {median(values):.1f} nats (median; above 4)"
            yield Finding(lines[0].target, what, "sharp", agent)


def _predicted(lines: Lines) -> Iterator[Finding]:
    """p-values are uniform where measurements are as the motion and the agent's error say."""
    for agent in dict.fromkeys(agent for line in lines for agent in line.p_values):
        own = [line for line in lines if agent in line.p_values]
        if len(own) < FEW_P_VALUES:
            continue
        far = [line for line in own if line.p_values[agent] < 0.05]
        usual = median(line.p_values[agent] for line in own)
        if len(far) > 0.15 * len(own):
            what = (
                f"{agent} measures outside of the predicted 95 % in {len(far)} of {len(own)} frames, first "
                f"in frame {far[0].frame} (expected 5 %; above 15 %)"
            )
            yield Finding(lines[0].target, what, "narrow", agent, far[0].frame)
        elif usual > 0.8:
            what = (
                f"{agent} measures closer to the prediction than predicted: p-value {usual:.2f} (median; "
                "above 0.8, expected 0.5)"
            )
            yield Finding(lines[0].target, what, "wide", agent)


def _lost(lines: Lines) -> Iterator[Finding]:
    lost = [line for line in lines if line.status == "lost"]
    if not lost:
        return
    decided = _decided(lines, lost[0])
    what = f"lost in {len(lost)} of {len(lines)} frames, decided in frame {decided}"
    is_gone = lines[-1].is_gone
    yield Finding(lines[0].target, what, "gone" if is_gone else None, frame=decided)


def _decided(lines: Lines, first: FrameMetrics) -> int:
    """The frame in which the status of a line was decided, as `log` has it: it applies from the next one."""
    place = lines.index(first)
    return lines[place - 1].frame if place else first.frame - 1


def _learning(lines: Lines) -> Iterator[Finding]:
    learnt = sum(line.learn_rate > 0 for line in lines)
    if learnt < len(lines) // 10:
        what = f"references learned in {learnt} of {len(lines)} frames only (below 10 %)"
        yield Finding(lines[0].target, what, "stale")


def _switching(lines: Lines, switches: int) -> Iterator[Finding]:
    if switches > len(lines) // 4:
        what = f"agents are switched {switches} times in {len(lines)} frames (above once in four)"
        yield Finding(lines[0].target, what, "flicker", measure="switching")


def _loudest(lines: Lines) -> str | None:
    """The agent with the largest contribution, on average."""
    totals: dict[str, float] = {}
    for line in lines:
        for agent, value in line.contribution.items():
            totals[agent] = totals.get(agent, 0.0) + value
    return max(totals, key=lambda agent: totals[agent], default=None)


CHECKS: Sequence[Callable[[Lines], Iterator[Finding]]] = (
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
            "an agent measures closer to the prediction than its error and the motion let expect",
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
