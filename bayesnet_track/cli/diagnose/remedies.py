"""Symptom, key, value: the table that `diagnose` and the page "which key do I turn" have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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
