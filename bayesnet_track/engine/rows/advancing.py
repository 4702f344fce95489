"""The first half of the frame of rows with a Gaussian belief: all of a table are updated at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_columns import STATUSES
from bayesnet_track.adapt.rule_inputs import GroupMeasures, Measures
from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.belief import GaussianPosterior, draw_boxes, report_gated
from bayesnet_track.belief.gaussian.rows import stand_for_each
from bayesnet_track.belief.gaussian.update import gated_of
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.groups import AgentMessages
from bayesnet_track.engine.lifecycle.association import RowAssociation
from bayesnet_track.engine.lifecycle.sharing import image_of
from bayesnet_track.engine.metrics import CLOUD_SIZE, BeliefSummary
from bayesnet_track.engine.rows.columns import GIVEN, GIVEN_NONE, NEVER_ASKED, Columns, Rows
from bayesnet_track.engine.rows.fitting import net_fits
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Estimate
from bayesnet_track.inference.compile import Plan
from bayesnet_track.journal.encoder import EncodedCloud, encode_clouds
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.frame_columns import ABSENT, texts
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import AREA, D2, FIT, HYPOTHESES, NATS, UD, Bools, Floats, Ints
from bayesnet_track.numerics.distributions import p_after, p_beyond
from bayesnet_track.numerics.gaussian import ALONE, roots
from bayesnet_track.observation.cue import Measurement, Reference

SHARES = tuple(NormalDist().inv_cdf((1.0 + share) / 2.0) for share in (0.5, 0.9))
"""Standard deviations to both sides within which so much of the centre's weight lies, as `metrics.SHARES`."""


@dataclass(frozen=True, eq=False)
class FilteredGaussians:
    """Targets of a plate after they were predicted and weighed by the detections that they are given.

    Attributes:
        before: their rows before the frame.
        columns: what is known of them, but for the rules' memory and the status.
        numbers: (T, 10) what was measured, in the columns of `numerics.arrays`.
    """

    before: Rows
    columns: Columns
    numbers: Floats
    keeps_status = True
    holds_frame = False
    is_hidden = None
    """No modes say whether a target can be seen."""
    beside = None
    """Nothing beside the columns is known of a target."""

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""
        return self.before.ids

    @property
    def compiled(self) -> CompiledPlate:
        """Their plate."""
        return self.before.rule.compiled

    @property
    def plan(self) -> Plan:
        """The compiled net of the frame."""
        return self.before.rule.plan

    @property
    def fields(self) -> tuple[str, ...]:
        """The D fields of a state."""
        return self.before.rule.motion.fields

    @property
    def references(self) -> Mapping[str, Sequence[Reference]]:
        """Agent -> its reference of each target, but for detections, which are columns."""
        return self.before.references

    @property
    def memory(self) -> RuleMemory:
        """Rule memory of all targets."""
        return self.before.columns.memory

    @property
    def hidden(self) -> Sequence[float]:
        """Of each target the expected share that cannot be seen."""
        return (0.0,) * len(self.before.ids)

    @property
    def existence(self) -> Floats | None:
        """(T,) probabilities that they exist; None where the plate has no `existence`."""
        return None if self.before.rule.crowd is None else self.columns.existence

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Means (T, D) and covariances (T, D, D) of the beliefs."""
        return self.columns.mean, self.columns.covariance

    @property
    def is_unasked(self) -> Bools | None:
        """(T,) whether nobody looked for detections; None where somebody did."""
        unasked = self.columns.given == NEVER_ASKED
        return unasked if unasked.any() else None

    def nets(self, live: Mapping[str, TargetNet]) -> list[TargetNet]:
        """The live nets of the targets."""
        return [*map(live.__getitem__, self.before.ids)]

    @property
    def statuses(self) -> Ints:
        """(T,) places in `adapt.rule_columns.STATUSES`."""
        return np.asarray(self.before.columns.is_lost * STATUSES.index("lost"))

    def asks(self, nets: Sequence[TargetNet]) -> None:
        """Nothing but a streak asks for a decision."""

    def measures(self, areas_px2: Floats) -> GroupMeasures:
        """UD, contributions, ... of the beliefs."""
        numbers, rule = self.numbers.T.copy(), self.before.rule
        return GroupMeasures(
            uds={rule.root: numbers[UD]},
            areas=numbers[AREA],
            fits=numbers[FIT],
            agents=(rule.agent,),
            nats=numbers[NATS, :, None],
            of=self._measures_of,
        )

    def _measures_of(self, row: int) -> Measures:
        rule, agent = self.before.rule, self.before.rule.agent
        _, nats, _, _, agent_ud, ud, fit, area, strength, _ = self.numbers[row].tolist()
        silent = () if self.columns.given[row] == GIVEN else (agent,)
        return Measures(
            {rule.root: ud},
            {agent: agent_ud},
            {agent: 0.0},
            {agent: nats},
            {agent: strength},
            fit,
            area,
            silent,
        )

    def reports(self, frame: int) -> Mapping[int, tuple[Event, ...]]:
        """Row -> events of its update: a detection outside the gate was not used."""
        gate = self.before.rule.belief.settings.gate
        reports: dict[int, tuple[Event, ...]] = {}
        if gate >= 1.0:
            return reports
        for row in np.flatnonzero(self.numbers[:, D2]).tolist():
            gated = gated_of(self.before.rule.agent, float(self.numbers[row, D2]), gate, len(BOX_FIELDS))
            reports[row] = (report_gated(gated, gate, 0, frame, self.ids[row]),)
        return reports

    def of(self, row: int) -> Filtered:
        """Nothing: columns say all of these targets."""
        raise LookupError(f"target {self.ids[row]} is a row of a table of Gaussian beliefs")

    def heard(self, row: int) -> AgentMessages:
        """Its own detection, unless several targets share it."""
        rule, columns = self.before.rule, self.columns
        if rule.shares_detections or columns.given[row] != GIVEN:
            return AgentMessages()
        box = columns.own[row, :4]
        noise = np.diag(rule.association.variances(box) * rule.temperature)
        return AgentMessages(measured={rule.agent: Measurement(BOX_FIELDS, box, noise)})

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame."""
        return self.before.state(row)

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) means, which are the MAP states, too."""
        return self.columns.mean

    def apart(self, decided: Collection[int]) -> Mapping[int, str]:
        """All stay rows."""
        return {}

    def then(
        self,
        time: float,
        references: Mapping[str, Sequence[Reference]],
        memory: RuleMemory,
        decided: Collection[int],
        nets: Mapping[str, TargetNet],
    ) -> Rows:
        """The table after the frame: targets about which something was `decided` are lost, or found."""
        is_lost = self.before.columns.is_lost
        checked: Mapping[str, TargetNet] | None = nets
        if decided:
            live = [nets[self.ids[row]] for row in decided]
            is_lost = is_lost.copy()
            is_lost[[*decided]] = [net.status == "lost" for net in live]
            if not all(net_fits(self.before.rule, net) for net in live):
                checked = None
        columns = self.columns.changed(memory=memory, is_lost=is_lost)
        return self.before.changed(columns=columns, references=references, time=time, checked=checked)

    # -------------------------------------------------------------------------------- lines

    def summaries(self, work: FrameContext, hypotheses: bool) -> dict[str, BeliefSummary]:
        """Target -> its belief in a few numbers; without `hypotheses` none are drawn."""
        beliefs, rule, centre = self.columns, self.before.rule, self.columns.mean[:, :2]
        variances = np.diagonal(beliefs.covariance, axis1=1, axis2=2)
        sds = np.sqrt(np.maximum(variances[:, :2], 0.0))
        regions = [
            np.stack([centre - reach * sds, centre + reach * sds], axis=2).reshape(-1, 4).tolist()
            for reach in SHARES
        ]
        clouds = self._clouds(work) if hypotheses else [EncodedCloud()] * len(self.ids)
        log_evidence, nats, ess, size, *_ = self.numbers.T.tolist()
        columns = zip(variances, ess, nats, zip(*regions, strict=True), clouds, strict=True)
        numbers = zip(log_evidence, size, self._p_values(), strict=True)
        return {
            target: BeliefSummary(
                spread,
                row_ess,
                surprise,
                [*map(tuple, two)],
                cloud,
                beliefs.mean[row, :4],
                log,
                int(count),
                GaussianPosterior(beliefs.mean[row], beliefs.covariance[row], rule.motion.fields, int(count)),
                p_values={} if value is None else {rule.agent: value},
            )
            for row, (target, (spread, row_ess, surprise, two, cloud), (log, count, value)) in enumerate(
                zip(self.ids, columns, numbers, strict=True)
            )
        }

    def _clouds(self, work: FrameContext) -> list[EncodedCloud]:
        """Hypotheses drawn from the belief of each."""
        columns, streams = self.columns, work.engine.streams
        draws = streams.of_each(work.births_of(self.ids), self.before.rule.root, work.moment, "cloud")
        clouds = np.empty((len(self.ids), CLOUD_SIZE, 4))
        for row, (lower, rng) in enumerate(zip(roots(columns.covariance[:, :4, :4]), draws, strict=True)):
            clouds[row] = draw_boxes(columns.mean[row], lower, CLOUD_SIZE, rng)
        return encode_clouds(np.rint(clouds).astype(np.int64))

    def _p_values(self) -> list[float | None]:
        """P-value of each one's detection under its prediction; None of one that several targets share."""
        rule, columns = self.before.rule, self.columns
        p_values: list[float | None] = [None] * len(self.ids)
        unshared = np.flatnonzero((columns.given == GIVEN) & (not rule.shares_detections))
        boxes = columns.own[unshared, :4]
        noise = (rule.association.variances(boxes) * rule.temperature)[:, :, None] * np.eye(4)
        values = p_after(boxes, noise, columns.mean[unshared, :4], columns.covariance[unshared, :4, :4])
        d2 = self.numbers[unshared, D2]
        if d2.any():  # what was not used left no trace in the belief
            values[d2 > 0.0] = p_beyond(d2[d2 > 0.0], len(BOX_FIELDS))
        for row, value in zip(unshared.tolist(), values.tolist(), strict=True):
            p_values[row] = value
        return p_values

    def line_columns(
        self,
        work: FrameContext,
        boxes: Floats,
        is_lost: Bools,
        levels_px2: Floats,
        rates: Sequence[float],
    ) -> dict[str, NDArray[Any]]:
        """The columns of `journal.frame_columns`, without hypotheses."""
        beliefs, rule = self.columns, self.before.rule
        log_evidence, nats, ess, size, agent_ud, ud, fit, area, strength, _ = self.numbers.T
        suffix, nothing = f"/{rule.agent}", np.zeros(len(self.ids))
        variances = np.diagonal(beliefs.covariance, axis1=1, axis2=2)[:, :4]
        p_values = [ABSENT if value is None else value for value in self._p_values()]
        columns: dict[str, NDArray[Any]] = {
            "frame": np.array(work.frame.index, dtype="<i8"),
            "time_s": np.array(work.frame.time_s, dtype="<f8"),
            "target": texts(self.ids),
            "box": np.ascontiguousarray(boxes.T),
            "map": np.ascontiguousarray(beliefs.mean[:, :4].T),
            "sd": np.ascontiguousarray(np.sqrt(np.maximum(variances, 0.0)).T),
            "ud_px2": ud,
            f"ud_nodes/{rule.root}": ud,
            "quiet_px2": np.where(np.isnan(levels_px2), ABSENT, levels_px2),
            "status": texts("lost" if lost else "tracking" for lost in is_lost.tolist()),
            "score": fit / (1.0 + ud / np.maximum(area, 1.0)),
            "log_evidence": log_evidence,
            "surprise": nats,
            "ess": ess,
            "learn_rate": np.array(rates),
            "particles": size.astype("<i4"),
            "active": np.full(len(nothing), rule.agent.encode()),
            "silent": np.where(beliefs.given == GIVEN, b"", rule.agent.encode()),
            "kl" + suffix: nothing,
            "contribution" + suffix: nats,
            "agent_ud_px2" + suffix: agent_ud,
            "strength" + suffix: strength,
            "p_values" + suffix: np.array(p_values),
        }
        if rule.crowd is not None:
            columns["existence"] = beliefs.existence
        sds = np.sqrt(np.maximum(np.diagonal(beliefs.covariance, axis1=1, axis2=2), 0.0))
        for place, name in enumerate(rule.motion.fields[4:], 4):
            columns[f"state/{name}"], columns[f"state/{name}_sd"] = beliefs.mean[:, place], sds[:, place]
        return columns


def filter_gaussians(work: FrameContext, rows: Rows, detections: RowAssociation) -> FilteredGaussians:
    """The rows of a table, updated by what each is given: the arrays of `detections` are changed in place."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.pair_kernels import measure_and_mix_rows
    from bayesnet_track.numerics.kernels.row_kernels import update_rows

    rule, start, frame = rows.rule, work.engine.clock(), work.frame
    moments, marginal = (detections.mean, detections.covariance), detections.marginal
    image = image_of(rule, frame.width, frame.height)
    draws = _draw(work, rows, moments)
    if marginal is None:
        boxes = np.ascontiguousarray(detections.own[:, :4])
        variances = rule.association.variances(boxes) * rule.temperature
        variances[~detections.is_given] = 1.0
        limits = rule.floor, rule.farthest, ALONE
        numbers = update_rows(
            moments, boxes, detections.is_given, variances, draws, limits, image, rule.counts
        )
    else:
        starts = marginal.starts[: len(rows.ids) + 1]
        boxes = np.ascontiguousarray(detections.boxes[marginal.columns[: starts[-1]]])
        numbers = measure_and_mix_rows(
            moments,
            starts,
            boxes,
            rule.association.variances(boxes) * rule.temperature,
            (marginal.weights[: starts[-1]], marginal.missed[: len(rows.ids)]),
            draws,
            (rule.floor, ALONE),
            image,
            rule.counts,
        )
    columns = rows.columns.changed(
        mean=detections.mean,
        covariance=detections.covariance,
        size=numbers[:, HYPOTHESES].astype(np.int64),
        own=detections.own,
        given=np.where(detections.is_given, GIVEN, GIVEN_NONE if detections.looked else NEVER_ASKED),
        existence=detections.existence,
        observed=detections.observed,
    )
    work.charge("belief", start)
    return FilteredGaussians(rows, columns, numbers)


def _draw(work: FrameContext, rows: Rows, moments: tuple[Floats, Floats]) -> Floats:
    """(T, N, 4) boxes drawn from the predictions; (T, 0, 4) where sigma points stand for them."""
    rule, count = rows.rule, len(rows.ids)
    settings = rule.belief.settings
    if settings.likelihood == "sigma_points":
        return np.empty((count, 0, 4))
    motion = work.confined(rule.motion)
    draws = work.engine.streams.of_each(work.births_of(rows.ids), rule.root, work.moment, "samples")
    supports = stand_for_each([*zip(*moments, strict=True)], motion, settings, draws)
    return np.array([support.states[:, :4] for support in supports]).reshape(count, -1, 4)
