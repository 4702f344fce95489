"""The settings of calibration: the probability of being on target, and the regions that are reported."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated

from pydantic import Field

from bayesnet_track.graph.settings.base import (
    AgentChoice,
    Choice,
    FrameCount,
    Model,
    Name,
    NotNegative,
    Number,
    Positive,
)
from bayesnet_track.graph.settings.motion import HeavyTail


class Verifier(Model):
    """A cue that is asked about the estimate alone: it moves no box, and shows whether it still looks right.

    Its log-likelihood of the estimate is a feature of the score. It learns in the first frame, and whenever
    it is asked and the score is at least 0.1. One that learns slowly remembers what the target was like
    before.

    Example::

        texture: {agent: texture, learn_rate: 0.04, coefficient: 0.3}
    """

    agent: AgentChoice = Field(description="the cue, with its parameters")
    coefficient: Number = Field(default=0.0, description="of its log-likelihood of the estimate, nats")
    learn_rate: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.04, description="how far its reference moves toward the estimate in a frame; 0: never"
    )
    every: FrameCount = Field(
        default=1, description="frames from one question to the next; asked in the first one, too"
    )


class Logistic(Model):
    """Probability of being on target, 1 / (1 + exp(-(bias + sum of coefficient times feature))).

    On target means an overlap (IoU) above 0.5 with the ground truth. Features are filtered over frames, s <-
    s + (1 - exp(-1 / memory_frames)) (x - s), beginning with the first frame's; a verifier's over the frames
    in which it is asked. `bayesnet-track fit` estimates the coefficients from videos with ground truth.
    """

    bias: Number = Field(description="log odds where every feature is 0")
    log_ud_box: Number = Field(default=0.0, description="log of UD as a share of the estimate's area")
    evidence: Number = Field(
        default=0.0,
        description="log evidence of an agent (log of its mean likelihood under the prediction) above its "
        "median in its first 20 frames, mean over the active agents that saw something, nats",
    )
    log_fit: Number = Field(
        default=0.0,
        description="log of the largest likelihood of a hypothesis, geometric mean over these agents",
    )
    agreement: Number = Field(
        default=0.0,
        description="log-likelihood of the most probable hypothesis less that of an agent's own best, mean "
        "over these agents, nats",
    )
    log_size: Number = Field(default=0.0, description="|log| of the estimate's sqrt(w h) over the first one")
    border: Number = Field(
        default=0.0,
        description="how far the estimate extends beyond the image, as when the target leaves it: 0 inside, "
        "1 from a tenth of its side on",
    )
    confidence: dict[Name, Number] = Field(
        default_factory=dict,
        description="agent that measures -> coefficient of the log odds of its own confidence that what it "
        "measured is the target; within -6.9 and 6.9, the last one while it rests",
    )
    verifiers: dict[Name, Verifier] = Field(
        default_factory=dict, description="further cues, each asked about the estimate alone"
    )
    memory_frames: Annotated[Number, Field(ge=0, le=1e6)] = Field(
        default=10.0, description="frames over which features are smoothed; 0 takes them as they are"
    )
    full_fit: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.0,
        description="the score is at most fit / full_fit, where fit is the likelihood of "
        "`log_fit` in this frame alone, so that it falls at once when nothing fits; 0: no such bound",
    )

    @cached_property
    def coefficients(self) -> Mapping[str, float]:
        """Feature -> its coefficient; those of verifiers by their names, an agent's as `confidence.agent`."""
        verifiers = {name: verifier.coefficient for name, verifier in self.verifiers.items()}
        confidence = {confidence_feature(agent): slope for agent, slope in self.confidence.items()}
        return {name: getattr(self, name) for name in FEATURES} | confidence | verifiers


CONFIDENCE = "confidence."
"""How the names of features begin that agents say themselves; no other name has a dot."""


def confidence_feature(agent: str) -> str:
    """The feature of a score that is the confidence of an agent."""
    return CONFIDENCE + agent


FEATURES = ("log_ud_box", "evidence", "log_fit", "agreement", "log_size", "border")
"""What every score can go by; the coefficients of `Logistic` have these names."""


class Score(Choice):
    """Computation of a frame's score."""

    logistic: Logistic | None = Field(default=None, description="a logistic function of a few features")


class Localization(Model):
    """The localization error that is added to the belief in the reported regions and sds.

    The true centre is taken to be a hypothesis' centre plus Gaussian noise: of sd `sd_box` with probability
    p, of sd `lost_sd_box` with probability 1 - p, where p is the score. With a heavy tail, the first sd is
    larger in a share of the cases: how far off a tracker is differs between videos more than within them. The
    belief itself is not changed.
    """

    sd_box: NotNegative = Field(default=0.05, description="sd on each axis while on target, sqrt(w h)")
    lost_sd_box: Positive | None = Field(
        default=None,
        description="sd on each axis while off target, sqrt(w h); needs `score`; default: as on target",
    )
    heavy_tail: HeavyTail | None = Field(default=None, description="heavy tails while on target")


class Distractors(Model):
    """Look-alikes, which may be followed instead of the target when they pass it.

    In frames in which all agents are evaluated, a distractor is a hypothesis at least `beyond_box` from the
    most probable one whose log-likelihood is less than `within_nats` below that one's. After `frames` of them
    the score is at most one half, because the net cannot know which of the two it follows: until motion
    shows it, or for `hold` frames.
    """

    within_nats: Positive = Field(default=4.0, description="difference of log-likelihoods, nats")
    beyond_box: Positive = Field(default=0.5, description="distance from the most probable one, sqrt(w h)")
    fit: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.01, description="distractors are ignored while the best hypothesis fits less"
    )
    frames: FrameCount = Field(default=2, description="consecutive frames with a distractor")
    hold: FrameCount = Field(
        default=250, description="frames for which the score stays limited where motion does not show it"
    )


class Guarantee(Model):
    """A bound on the share of frames that are called tracking while off target, on average over videos.

    The status is tracking only while the mean score of the last `frames` frames is above `above`; else it is
    at most uncertain. Only what is reported changes: motion, learning and rules go by the status as it is
    without. `bayesnet-track fit --guarantee` finds `above` by conformal risk control over whole videos, and
    lower levels for a run that is over: `bayesnet-track export --afterwards`.
    """

    above: Annotated[Number, Field(ge=0, le=1)] = Field(description="level of the mean score")
    frames: FrameCount = Field(default=3, description="frames of the mean, fewer at the start")
    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="expected share of such frames that it was calibrated for; only reported"
    )
    afterwards: tuple[Annotated[Number, Field(ge=0, le=1)], ...] = Field(
        default=(),
        description="levels of a run that is over: the k-th of n is for one with at most k / n of its frames "
        "above",
    )


class Alarm(Model):
    """An alarm whose probability of being false is bounded over a whole video.

    X = exp(C) with C <- max(0, C + clip(log((1 - score) / score) - 1, -1, 1)) grows while the score is below
    0.27. The alarm is raised when the e-value (videos + 1) X / (total + X) reaches 1 / share. It changes
    nothing but what is reported. `bayesnet-track fit --alarm` estimates `total` from whole videos.
    """

    total: Positive = Field(description="sum of the largest X of each calibration video while it was held")
    videos: FrameCount = Field(description="calibration videos")
    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="probability of a false alarm in a whole video, at most"
    )
