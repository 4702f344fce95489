"""Settings of births, recognition, ends, existence and joins, and of the posterior over who is who."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.base import (
    FrameCount,
    Model,
    Name,
    NotNegative,
    Number,
    PluginChoice,
    Positive,
    Share,
    Truth,
    Whole,
    word_or_mapping,
)

Inner = Annotated[Number, Field(gt=0, lt=1)]


class Existence(Model):
    """Every target has a probability that it exists: births and ends are levels of it, instead of counts.

    It falls by `survival` from frame to frame, rises with a detection where the target is expected, the more
    the fewer false detections there are, and falls with every miss, the more the surer a detection was. What
    is detected and is no target yet has a probability, too, and becomes a target at `confirm`.
    `birth.confirm` has no effect then. Uniform over the image, and distributed in size as the detections are,
    false detections and new targets have a density in x, y, w, h.
    """

    detection: Inner | None = Field(
        default=None,
        description="probability that a target which nothing covers is detected; default: estimated",
    )
    covered: Inner | None = Field(
        default=None,
        description="the same while another target covers at least half of its box; default: estimated",
    )
    survival: Annotated[Number, Field(gt=0, le=1)] = Field(
        default=0.995, description="probability that a target is still there one frame interval later"
    )
    clutter: NotNegative | None = Field(
        default=None, description="false detections a frame, on average; default: estimated"
    )
    missed_frames: Annotated[Number, Field(ge=1)] = Field(
        default=6.0,
        description="mean length of runs of frames in which a target that nothing covers cannot be detected; "
        "how often they begin is estimated; 1: each miss is independent",
    )
    false_frames: Annotated[Number, Field(ge=1)] = Field(
        default=5.0,
        description="mean length of runs of false detections in one place; how often they begin is "
        "estimated; 1: each false detection is independent",
    )
    births: Positive = Field(default=0.1, description="new targets a frame, on average")
    confirm: Inner = Field(default=0.9, description="probability from which on it is a target")
    end: Inner = Field(default=0.05, description="probability below which a target ends")

    @model_validator(mode="after")
    def _end_below_confirm(self) -> Self:
        if self.end >= self.confirm:
            raise ValueError(f"end below confirm: {self.end:g} is not below {self.confirm:g}")
        return self


class DetectorChoice(PluginChoice):
    """A detector and its parameters, not yet checked against the detector.

    Written ``detector: background`` or ``detector: {background: {min_area_px: 200}}``; parameters are those
    of `bayesnet-track detect`. ``detections`` stands for what a file holds (`run --detections FILE`); it
    takes the parameters that all detectors have.
    """

    WORD = "detector"

    detector: str = Field(max_length=64)


class Confirm(Model):
    """A detection becomes a target after `hits` in the detector's last `of` runs, this one included."""

    hits: Annotated[Whole, Field(ge=1, le=1000)] = Field(
        default=3, description="runs of the detector in which it is seen"
    )
    of: Annotated[Whole, Field(ge=1, le=1000)] = Field(default=4, description="runs that count")

    @model_validator(mode="after")
    def _no_more_than_there_are(self) -> Self:
        if self.hits > self.of:
            raise ValueError(f"no more hits than `of`: {self.hits} of {self.of} cannot be")
        return self


class Pace(Model):
    """Runs of the detector by what there is to see; while there are targets, `every` says it.

    Targets are carried by their motion between runs, and nobody is missed. What is new is confirmed at once
    where `waiting` is 1, and an empty image takes little time.
    """

    waiting: FrameCount = Field(
        default=1, description="frames between runs while something was detected that may become a target"
    )
    empty: FrameCount = Field(
        description="frames between runs while there is neither a target nor what may become one"
    )


def _word_or_number(value: object) -> str:
    return "word" if isinstance(value, str) else "number"


class Birth(Model):
    """Detections that no live target claims become targets of this plate, each with its own net.

    A live target claims one detection: the nearest within `min_distance_box`, or within twice the sd of its
    belief beyond that. Further ones within `min_distance_box`, or that share at least `max_overlap` of the
    smaller box with it, are taken for the same object. A lost target claims none. If an agent measures by
    detections, these are assigned to targets first, lost ones included, by the parameters of that agent.
    """

    detector: DetectorChoice = Field(description="what finds targets")
    labels: tuple[str, ...] = Field(
        default=(), max_length=64, description="only detections with one of these labels; default all"
    )
    every: FrameCount = Field(default=1, description="frames between runs of the detector")
    pace: Pace | None = Field(
        default=None, description="other frames between runs while it is empty, or something waits"
    )
    confirm: Confirm = Field(default=Confirm(), description="how often it is detected before it gets a net")
    max_targets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        default=20, description="live targets of this plate at most"
    )
    min_distance_box: NotNegative = Field(
        default=0.5,
        description="smallest distance between the centres of a new and a live target, in the mean of both "
        "sqrt(w h)",
    )
    max_overlap: Annotated[
        Annotated[Literal["never"], Tag("word")] | Annotated[Share, Tag("number")],
        Discriminator(_word_or_number),
    ] = Field(
        default=0.5,
        description="overlap, as a share of the smaller box, from which on two boxes are one object, or "
        "never",
    )
    min_score: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.0, description="least score of a detection that starts a target, or a candidate for one"
    )
    tentative: Truth = Field(
        default=False,
        description="candidates are tentative tracks: each has a belief, and detections are shared out among "
        "targets and candidates alike; default, a candidate takes the nearest detection that is left",
    )

    @property
    def covered(self) -> float | None:
        """`max_overlap`; None: never."""
        return None if self.max_overlap == "never" else self.max_overlap

    def frames_between(self, has_targets: bool, has_candidates: bool) -> int:
        """Frames between runs of the detector, by what was there in the last frame.

        >>> birth = Birth(detector=DetectorChoice(detector="motion"), every=2, pace=Pace(empty=5))
        >>> birth.frames_between(True, False), birth.frames_between(False, False)
        (2, 5)
        >>> birth.frames_between(False, True)
        1
        """
        if self.pace is None:
            return self.every
        if has_candidates:
            return self.pace.waiting
        return self.every if has_targets else self.pace.empty


class MergeDuplicates(Model):
    """Of two nets of a plate whose beliefs overlap for so long, none of them lost, the younger one ends.

    The overlap is the Bhattacharyya coefficient of the Gaussians with the beliefs' moments of x, y, w, h,
    widened by a tenth of the mean box (places so close are one object): 1 for the same belief, 0 apart.
    """

    overlap: Annotated[Number, Field(gt=0, le=1)] = Field(default=0.7, description="overlap of the beliefs")
    frames: FrameCount = Field(default=5, description="consecutive frames with at least this overlap")


class Death(Model):
    """The net of a target ends when the target has been lost, or has claimed no detection, for so long."""

    lost_frames: FrameCount = Field(default=30, description="consecutive frames in which it is lost")
    unseen_frames: FrameCount | None = Field(
        default=None,
        description="consecutive frames since it last claimed a detection; default: it need not claim any",
    )


class Reidentify(Model):
    """Conditions under which a detection is taken for a target that is lost, or whose net has ended.

    P(it is k) = o_k / (1 + sum o), the 1 standing for a new target, o_k = g p_k(x, y) A r_k: g = exp(-t /
    frames) for t frames since k was last well seen, A the frame's area, p_k = g N(where its motion leads it)
    + (1 - g) / A, and r_k the likelihood of the box by its references over that of boxes elsewhere, of which
    one in twenty is assumed to look like it.
    """

    frames: FrameCount = Field(
        default=300,
        description="frames over which the memory fades; a target whose net has ended is forgotten after as "
        "many",
    )
    min_probability: Annotated[Number, Field(gt=0, le=1)] = Field(
        default=0.5, description="smallest probability at which it is taken for that target"
    )
    lost: Truth = Field(default=True, description="whether a detection can also find a target that is lost")


@dataclass(frozen=True)
class LifeRules:
    """The rules of one plate, defaults filled in; None where there is no rule.

    Attributes:
        birth: where targets come from.
        merge_duplicates: when two nets track the same target.
        death: when a net ends.
        reidentify: how targets are re-identified.
        existence: how probable it is that targets exist.
    """

    birth: Birth | None
    merge_duplicates: MergeDuplicates | None
    death: Death | None
    reidentify: Reidentify | None
    existence: Existence | None = None


OrNever = Discriminator(word_or_mapping)
Never = Annotated[Literal["never"], Tag("word")]
MergeOrNever = Annotated[Never | Annotated[MergeDuplicates, Tag("mapping")], OrNever]
ReidentifyOrNever = Annotated[Never | Annotated[Reidentify, Tag("mapping")], OrNever]


def life_rules(
    birth: Birth | None,
    merge_duplicates: MergeOrNever | None,
    death: Death | None,
    reidentify: ReidentifyOrNever | None,
    existence: Existence | None = None,
) -> LifeRules | None:
    """The rules of a plate with these settings; None when its targets live as long as the run."""
    if birth is None:
        merge = merge_duplicates if isinstance(merge_duplicates, MergeDuplicates) else None
        return LifeRules(None, merge, death, None) if merge or death else None
    return LifeRules(
        birth,
        None if merge_duplicates == "never" else merge_duplicates or MergeDuplicates(),
        death or Death(),
        None if reidentify == "never" else reidentify or Reidentify(),
        existence,
    )


class Exclusion(Model):
    """Two targets cannot be explained by the same pixels.

    Where two boxes overlap, the pixels give evidence for the one in front only. Without `occlusion` either
    may be in front, independently in every frame.
    """

    nats: NotNegative = Field(
        default=0.0,
        description="further log-odds against one box lying wholly on the other; large for objects that never"
        " hide each other, such as people seen from above",
    )


class Occlusion(Model):
    """The order in depth of two targets: a variable with two values that persists over frames.

    The box of the target behind gives evidence by its visible share only. The rest counts with its `level`,
    the evidence that the target had in frames in which it was visible: being hidden is better than matching
    badly, and worse than matching well.
    """

    stay: Annotated[Number, Field(ge=0.5, lt=1)] = Field(
        default=0.95, description="probability that the order is that of the last frame"
    )


class Attachment(Model):
    """A target of the second kind may be carried by one of the first: then it moves as that one does.

    Whether it is carried is a part of each of its hypotheses. `between` names the carrier's kind, then the
    carried one's.
    """

    start: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="probability per frame that it is picked up"
    )
    stay: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.97, description="probability per frame that it stays carried"
    )
    sd_px: Positive = Field(
        default=1.0, description="sd of its motion relative to the carrier's, px per frame"
    )


class Together(Model):
    """Conditions under which two nets are joined, and part.

    The overlap of two beliefs is that of their reaches, as a share of the smaller one: a reach is the mean
    box, widened by one sd of the centre on each side.
    """

    overlap: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.05,
        description="smallest overlap at which they are joined; 0, of a `factor` alone: always",
    )
    apart_frames: FrameCount = Field(
        default=5, description="consecutive frames with a smaller overlap before they part"
    )


class Join(Model):
    """Dependence of targets of these kinds on each other while they are near.

    Example::

        joins:
          - between: [person, box]
            occlusion: {stay: 0.95}
            attachment: {start: 0.05, stay: 0.97}
            when: {overlap: 0.05, apart_frames: 5}
    """

    between: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)] | None = Field(
        default=None,
        description="one kind of target with itself, or two with each other; default every pair of kinds, a "
        "kind with itself included",
    )
    exclusion: Exclusion | None = Field(default=None, description="no pixel is evidence for two targets")
    occlusion: Occlusion | None = Field(default=None, description="as `exclusion`, and the order persists")
    attachment: Attachment | None = Field(default=None, description="one may carry the other")
    factor: Annotated[str, Field(max_length=MAX_CHARACTERS)] | None = Field(
        default=None,
        description="[expression](expressions.md) of the two states, `a.x` of the first kind and `b.x` of "
        "the second; a density up to a constant",
    )
    when: Together = Field(default=Together(), description="when they are joined")
    pairings: Annotated[Whole, Field(ge=1, le=64)] = Field(
        default=8, description="hypotheses of the other target that each hypothesis is paired with"
    )

    @model_validator(mode="after")
    def _joins_something(self) -> Self:
        if (self.exclusion, self.occlusion, self.attachment, self.factor) == (None,) * 4:
            raise ValueError("at least one of exclusion, occlusion, attachment, factor")
        return self

    @property
    def shares_pixels(self) -> bool:
        """True when pixels of both are accounted for."""
        return self.exclusion is not None or self.occlusion is not None

    @property
    def reweights(self) -> bool:
        """True when hypotheses of both are weighed together: by shared pixels, or by a factor."""
        return self.shares_pixels or self.factor is not None

    @property
    def stay(self) -> float:
        """Probability that the order persists; a half, no memory, without `occlusion`."""
        return 0.5 if self.occlusion is None else self.occlusion.stay

    @property
    def nats(self) -> float:
        """Log-odds against a box that lies wholly on the other."""
        return 0.0 if self.exclusion is None else self.exclusion.nats

    def holds_between(self, first: str, second: str) -> bool:
        """True when it is about targets of these two kinds."""
        if self.between is None:
            return True
        return {first, second} == set(self.between) and (first == second) == (len(set(self.between)) == 1)


def join_of(joins: tuple[Join, ...], first: str, second: str) -> int | None:
    """Index of the join between two kinds, of the first that fits; None when there is none."""
    return next((k for k, join in enumerate(joins) if join.holds_between(first, second)), None)


class Identity(Model):
    """Probability of who is who: targets that come close may part under each other's names.

    From when two targets expect each other's detections until they have been apart for `settle` frames, every
    assignment of detections to them is kept with its probability, for up to four targets at once. Further
    ones that come close meanwhile keep their names, and are not asked about.
    """

    settle: FrameCount = Field(default=8, description="frames apart after which who is who is settled")
    appearance: NotNegative = Field(
        default=0.1,
        description="exponent of the likelihood of what a target looked like before they met, in each frame: "
        "those of neighbouring frames tell much the same",
    )
    report_above: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="probability of another identity from which on the log says it"
    )
