"""Measurements of a frame, what ``frames.npy.gz`` holds: lines of targets, and answers to queries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


GONE = (
    "{kind} has no `box`, since the name did not say which convention: use .xywh (left, top, width, height), "
    ".xyxy (corners) or .cxcywh (centre, width, height)"
)
"""What to use in place of the attribute that was there."""


class HasBox:
    """A holder of a box, as float64 arrays (4,) in px. Centres of pixels lie at integers.

    The class has `centre_box`, the numbers centre x, y, width, height: `box` in the files of a run.
    """

    if TYPE_CHECKING:  # a field or property of the class that is one

        @property
        def centre_box(self) -> tuple[float, ...]:
            """Centre x, y, width, height in px."""

    @property
    def xywh(self) -> NDArray[np.float64]:
        """Left, top, width, height, as OpenCV and files of tracks have it."""
        from bayesnet_track.numerics.boxes import corner_from_centre

        return corner_from_centre(self.centre_box)

    @property
    def xyxy(self) -> NDArray[np.float64]:
        """Left, top, left + width, top + height, as supervision has it."""
        from bayesnet_track.numerics.boxes import xyxy_from_centre

        return xyxy_from_centre(self.centre_box)

    @property
    def cxcywh(self) -> NDArray[np.float64]:
        """Centre x and y, width, height, as the journal and the engine have it."""
        import numpy as np

        return np.array(self.centre_box, dtype=np.float64)

    if not TYPE_CHECKING:  # for type checkers it does not exist

        @property
        def box(self):
            """Not there any more; raises AttributeError, which says what to use."""
            raise AttributeError(GONE.format(kind=type(self).__name__))

    def _xywh_text(self) -> str:
        return ",".join(f"{value:.1f}" for value in self.xywh)


NOT_SHOWN = ("lost", "hidden")
"""Statuses in which the box does not show the target; `hidden` where the graph models what hides it."""


@dataclass(frozen=True, repr=False)
class PartMetrics(HasBox):
    """Measurements of one part of a target in one frame.

    Attributes:
        centre_box: estimate, the mean of the part's belief given all that was seen, centre box x, y, w, h in
            px.
        sd: posterior sd of x, y, w, h in px.
        ud_px2: uncertainty deviation about the estimate; the same as in `ud_nodes`.
        status: seen, hidden (its active agents find nothing like it) or unwatched (none of its agents is
            active); when hidden or unwatched it is inferred from the rest of the target.
    """

    centre_box: tuple[float, ...] = field(metadata={"key": "box"})
    sd: tuple[float, ...]
    ud_px2: float
    status: str

    def __repr__(self) -> str:
        return f"<part: {self.status}, xywh {self._xywh_text()}>"


@dataclass(frozen=True)
class JoinMetrics:
    """Results of a joint belief of one target in one frame.

    Attributes:
        others: targets that it is joined with.
        hidden: expected share of its box that is hidden by one of them.
        behind: the one that most probably hides it, or empty.
        in_front: the other -> probability that this target is in front of it.
        attached: probability that it is carried; None when nothing may carry it.
        ess_own: effective hypotheses before the joint belief.
    """

    others: tuple[str, ...]
    hidden: float
    behind: str
    in_front: Mapping[str, float]
    attached: float | None
    ess_own: float


@dataclass(frozen=True, repr=False)
class FrameMetrics(HasBox):
    """Measurements of one target in one frame.

    Attributes:
        frame: frame index.
        time_s: frame time in seconds; NaN in a `Tracker` that is given neither times nor `fps`.
        target: target id.
        centre_box: estimate, centre box x, y, w, h in px.
        map: maximum a posteriori box.
        sd: posterior sd of x, y, w, h in px; those of x and y include the graph's localization_error.
        ud_px2: uncertainty deviation at the root.
        ud_nodes: inference node -> its UD in px^2.
        quiet_px2: measured baseline of UD at the root, or None.
        status: tracking, uncertain, lost, or hidden: lost because it is probably hidden, by its modes.
        score: probability of being on target (an IoU above 0.5) if the graph has coefficients for it; else an
            uncalibrated index in 0..1 from UD and evidence, high when certain.
        log_evidence: log normalising constant of the frame. Of agents that measure it is a density, in the
            units of what they measured; others give a likelihood of at most 1.
        surprise: KL(posterior || prior) over the hypotheses, nats: how far the frame moved the belief.
        ess: effective sample size of the hypotheses' posterior weights.
        particles: number of hypotheses that the agents scored.
        active: agents that gave evidence in this frame.
        kl: active agent -> KL(belief || agent), nats.
        contribution: active agent -> KL(belief || belief without it), nats.
        agent_ud_px2: active agent -> UD about its own maximum-likelihood hypothesis.
        strength: node -> KL(prior times message || prior), nats: the information in its message.
        learn_rate: learning rate applied in this frame (0 when UD is above the threshold).
        region50: bounds of the central 50 % of the centre, with the graph's localization_error: x_low,
            x_high, y_low, y_high in px.
        region90: the same for the central 90 %.
        cloud: hypotheses drawn from the posterior, whole px, centre boxes.
        silent: active agents that measure and did not find the target.
        features: what a calibrated score was computed from; left out when the score is an index.
        parts: node that is a part of the target -> its own estimate; left out when there are none.
        angle: rotation in the image since the first frame, degrees, clockwise; left out while it is 0, as it
            is without `sd_angle_deg`.
        join: results of the joint belief; left out for a target that is not joined.
        existence: probability that it exists; left out when the graph has no `existence` for its type.
        modes: mode -> its probability; left out when the graph has no `modes`.
        modes_predicted: mode -> its probability before the frame's evidence.
        hidden: probability that the target is hidden; None, and left out, when the graph has no hidden mode.
        category: `team=red` -> its probability, of each value of each category; left out when the graph has
            no `category`.
        category_predicted: the same before the frame's evidence.
        e_value: evidence that the target is not held; left out when the graph has no `alarm`.
        p_values: agent that measured -> probability of a measurement farther from its prediction than it was;
            left out when there are none.
        log_predictive: agent that measured -> log density of what it measured under the belief before the
            frame, in the units of its quantities; left out when there are none.
        queries: answers by the names of queries: a probability or a mean, ``NAME_sd``, ``NAME_low`` and
            ``NAME_high`` of a number, ``NAME/TARGET`` of a pair with another target, ``NAME_count`` of all
            targets together; left out when the graph has no `queries`.
        state: mean of each field of the motion beside the box, such as `vx` in px per frame or a field of
            the graph's own, and its sd, as ``vx_sd``; in the frames tracked in; left out without any.
        identities: whose identity it may have, with probabilities, the most probable one first; left out
            while it is not doubtful, or where the graph has no `identity`.
    """

    frame: int
    time_s: float
    target: str
    centre_box: tuple[float, ...] = field(metadata={"key": "box"})
    map: tuple[float, ...]
    sd: tuple[float, ...]
    ud_px2: float
    ud_nodes: Mapping[str, float]
    quiet_px2: float | None
    status: str
    score: float
    log_evidence: float
    surprise: float
    ess: float
    particles: int
    active: tuple[str, ...]
    kl: Mapping[str, float]
    contribution: Mapping[str, float]
    agent_ud_px2: Mapping[str, float]
    strength: Mapping[str, float]
    learn_rate: float
    region50: tuple[float, ...]
    region90: tuple[float, ...]
    cloud: tuple[tuple[int, ...], ...]
    silent: tuple[str, ...] = ()
    features: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    parts: Mapping[str, PartMetrics] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    angle: float = field(default=0.0, metadata={"left_out_when_empty": True})
    join: JoinMetrics | None = field(default=None, metadata={"left_out_when_empty": True})
    existence: float | None = field(default=None, metadata={"left_out_when_empty": True})
    modes: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    modes_predicted: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    hidden: float | None = field(default=None, metadata={"left_out_when_empty": True})
    category: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    category_predicted: Mapping[str, float] = field(
        default_factory=dict, metadata={"left_out_when_empty": True}
    )

    @property
    def is_gone(self) -> bool:
        """True where the box does not show the target: it is lost, or hidden."""
        return self.status in NOT_SHOWN

    @property
    def mode(self) -> str:
        """The most probable mode; empty where the graph has no `modes`."""
        return max(self.modes, key=self.modes.__getitem__, default="")

    @property
    def categories(self) -> dict[str, dict[str, float]]:
        """Probability of each value of each category: ``categories["team"]["red"]``."""
        by_name: dict[str, dict[str, float]] = {}
        for key, probability in self.category.items():
            name, _, value = key.partition("=")
            by_name.setdefault(name, {})[value] = probability
        return by_name

    e_value: float | None = field(default=None, metadata={"left_out_when_empty": True})
    p_values: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    log_predictive: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    queries: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    state: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    identities: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})

    @property
    def ud_unit(self) -> str:
        """Unit of the UD at the root: m² of a state in metres, else px², as of views and agents."""
        return "m²" if "x_m" in self.state else "px²"

    def __repr__(self) -> str:
        """The main facts: who, when, how sure, where, and by whose evidence."""
        agents = ", ".join(self.active) or "no agent"
        status = "" if self.status == "hidden" else f"{self.status}, "
        hidden = (
            "" if self.hidden is None or self.hidden <= 0.5 else f"hidden, probability {self.hidden:.2f}, "
        )
        return (
            f"<target {self.target} in frame {self.frame}: {hidden}{status}score {self.score:.2f}, "
            f"xywh {self._xywh_text()}, {agents} active>"
        )


# ------------------------------------------------------------------------------------ queries

Subject = tuple[str, ...]
"""Ids of the targets that an answer is about: one, a pair, or none for all together."""

SD, LOW, HIGH = "_sd", "_low", "_high"
COUNT = "_count"
"""What is added to the name of a query for its numbers, and for the number of all targets together."""


@dataclass(frozen=True, repr=False)
class QueryAnswer:
    """One answer: a probability, or a number with its sd and interval.

    Attributes:
        mean: probability of a condition; mean of a number.
        sd: standard deviation of a number; None of a probability.
        low: lower bound of the central interval of a number; None of a probability.
        high: upper bound.
        unit: of a number, as the graph has it; empty without.
    """

    mean: float
    sd: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""

    @property
    def probability(self) -> float:
        """Probability of the condition.

        Raises:
            ValueError: the answer is a number.
        """
        if self.sd is not None:
            raise ValueError("a number has no probability; it has mean, sd, low, high")
        return self.mean

    def __repr__(self) -> str:
        if self.sd is None:
            return f"<probability {self.mean:.3g}>"
        unit = f" {self.unit}" if self.unit else ""
        return f"<{self.mean:.4g} ± {self.sd:.2g}{unit}, {self.low:.4g} to {self.high:.4g}>"


@dataclass(frozen=True, eq=False, repr=False)
class Answers(Mapping[str | Subject, QueryAnswer]):
    """Answers to one query in one frame, by target id, or by a pair of ids.

    Attributes:
        query: name of the query.
        kind: probability, value, count or crosses.
        subjects: the n targets or pairs that were asked.
        columns: (R, n) probabilities, R = 1; or means, sds, lower and upper bounds, R = 4.
        total: number of all targets together; None of a query that does not count.
        unit: of a number.
    """

    query: str
    kind: str
    subjects: Sequence[Subject]
    columns: NDArray[np.float64]
    total: QueryAnswer | None = None
    unit: str = ""

    @cached_property
    def _index(self) -> Mapping[Subject, int]:
        return {subject: place for place, subject in enumerate(self.subjects)}

    def __getitem__(self, subject: str | Subject) -> QueryAnswer:
        place = self._index[(subject,) if isinstance(subject, str) else tuple(subject)]
        numbers: list[float] = self.columns[:, place].tolist()
        if len(numbers) == 1:
            return QueryAnswer(numbers[0])
        mean, sd, low, high = numbers
        return QueryAnswer(mean, sd, low, high, self.unit)

    def __iter__(self) -> Iterator[str | Subject]:
        return (subject[0] if len(subject) == 1 else subject for subject in self.subjects)

    def __len__(self) -> int:
        return len(self.subjects)

    def __contains__(self, subject: object) -> bool:
        return ((subject,) if isinstance(subject, str) else subject) in self._index

    def __repr__(self) -> str:
        total = "" if self.total is None else f"total {self.total!r}, "
        return f"<{self.query}: {total}{dict(self)!r}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its columns: the query's name, and with what is added for sd and bounds."""
        return tuple(self.query + end for end in ("", SD, LOW, HIGH)[: len(self.columns)])

    @cached_property
    def by_target(self) -> Mapping[str, Mapping[str, float]]:
        """Target -> its numbers by name; those of a pair stand with the first, as ``NAME/SECOND``."""
        targets: dict[str, dict[str, float]] = {}
        rows = self.columns.T.tolist()
        for subject, row in zip(self.subjects, rows, strict=True):
            ends = "".join(f"/{second}" for second in subject[1:])
            numbers = targets.setdefault(subject[0], {})
            numbers.update(
                (name + ends, value) for name, value in zip(self.names, row, strict=True) if value == value
            )
        return targets

    @property
    def of_all(self) -> dict[str, float]:
        """The numbers of all targets together by name."""
        total = self.total
        if total is None or total.sd is None or total.low is None or total.high is None:
            return {}
        values = (total.mean, total.sd, total.low, total.high)
        ends = ("", SD, LOW, HIGH)
        return {f"{self.query}{COUNT}{end}": value for end, value in zip(ends, values, strict=True)}


def numbers_of(answers: Sequence[Answers], target: str) -> dict[str, float]:
    """All numbers of a target by name, with those of all targets together."""
    numbers: dict[str, float] = {}
    for answered in answers:
        numbers.update(answered.by_target.get(target, {}))
        numbers.update(answered.of_all)
    return numbers
