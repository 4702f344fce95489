"""Give targets their detections before they are weighed, for plates whose agents measure by them.

The detectors look, every target's belief is predicted, and the targets of a plate share its detections out:
as many as can be, the best for all together by where each is expected and, with `appearance`, by what it
looks like. What nobody gets is left to the life of targets (`track_management`). Targets are columns here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, first_observed, remembered
from bayesnet_track.adapt.existence import DetectionModel, UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.belief.gaussian.expected import ExpectedInModes, expect
from bayesnet_track.belief.motion.modes import moments_of
from bayesnet_track.engine.cameras import Watched, errors_at
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.assigning import (
    advance_tentative,
    assign_detections,
    give_detections,
    label_tentative,
    name_owners,
    remember_detections,
    score_looks,
    tentative_tracks,
)
from bayesnet_track.engine.lifecycle.detecting import Seen, look, scan
from bayesnet_track.engine.lifecycle.existing import (
    Crowd,
    MarginalAssociation,
    after_look,
    associate_marginal,
    expect_crowd,
    given_nothing,
)
from bayesnet_track.engine.lifecycle.refusing import record_refusals
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.sharing import TrackArrays, follow_owners, own_detections, predictor
from bayesnet_track.engine.lifecycle.unconfirmed import CrowdRule
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import Targets
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.journal.events.cameras import CameraKnocked
from bayesnet_track.journal.events.lives import DetectionsCut, DetectorFailed
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.likelihoods import ReferenceRows


@dataclass(frozen=True, eq=False)
class RowAssociation:
    """T rows as they are expected, and what they are given of N detections.

    Attributes:
        mean: (T, D).
        covariance: (T, D, D).
        own: (T, 5) the detection of each, and its score.
        is_given: (T,) whether there is one that may be its own.
        existence: (T,) probability that each exists.
        observed: (T, H) what is remembered of the detections of each.
        boxes: (N, 4) the detections.
        marginal: which of them may be whose, where targets share them by probability.
        looked: False in a frame in which nobody looked for detections.
    """

    mean: Floats
    covariance: Floats
    own: Floats
    is_given: Bools
    existence: Floats
    observed: Floats
    boxes: Floats
    marginal: MarginalAssociation | None = None
    looked: bool = True


@dataclass(frozen=True, eq=False)
class Associated:
    """Outcome of a look before the targets were weighed.

    Attributes:
        found: plate that looked -> its detections in the image of each camera, the best first.
        owners: plate whose agents measure by detections -> (N,) the target of each, or `TENTATIVE`.
        targets: every live target, the references of such agents with what they were given.
        history: as it was, with the detectors' states after the look, and tentative tracks after the frame.
        events: detectors that failed, and cameras that were knocked.
        given: plate -> what the rows of its table are given.
    """

    found: dict[str, Seen]
    owners: Mapping[str, tuple[str | None, ...]]
    targets: Targets
    history: TrackHistory
    events: tuple[DetectorFailed | DetectionsCut | CameraKnocked, ...]
    given: Mapping[str, RowAssociation]


def associate_first(work: FrameContext, targets: Targets, history: TrackHistory) -> Associated:
    """Association of detections and targets, for plates with agents that measure by them."""
    net, start = work.net, work.engine.clock()
    tables = {rows.rule.plate: rows for rows in targets.gaussians}
    states = targets.apart()

    def live_targets(plate: str) -> list[str]:
        ids = tables[plate].ids if plate in tables else ()
        of_plate = (*ids, *(target for target in states if net.targets[target].template == plate))
        return [target for target in of_plate if net.targets[target].status != "lost"]

    detections, history, looked = look(work, history, partial(_expected_boxes, work, targets), live_targets)
    events: tuple[DetectorFailed | DetectionsCut | CameraKnocked, ...] = looked
    owners: dict[str, tuple[str | None, ...]] = {}
    given_rows: dict[str, RowAssociation] = {}
    for plate, compiled in work.engine.plates.items():
        if not compiled.association_rules:
            continue
        members = {target: state for target, state in states.items() if net.targets[target].template == plate}
        sharing = Several(work, compiled, tables.get(plate), members)
        if CrowdRule.of(compiled) is None:
            shared = sharing.assign(history, detections.get(plate, {}).get(""))
        else:
            shared = sharing.associate_marginal(history, looks_of(work, plate, detections))
        history, events = shared.history, (*events, *shared.events)
        states |= shared.others
        if shared.rows is not None:
            given_rows[plate] = shared.rows
        if plate in detections or compiled.plate.inverses or not compiled.has_one_image:
            owners[plate] = shared.owners
    work.charge("life", start)
    updated = Targets(targets.gaussians, (), states, [*states]) if states else targets
    return Associated(detections, owners, updated, history, events, given_rows)


def looks_of(work: FrameContext, plate: str, detections: Mapping[str, Seen]) -> dict[str, Found]:
    """Agent of a plate with existence -> what it is given, of those whose sensor or detector looked."""
    compiled = work.engine.plates[plate]
    if compiled.plate.inverses:
        return scan(work, plate)
    by_camera = detections.get(plate, {})
    return {agent: by_camera[camera] for agent, camera in compiled.cameras.items() if camera in by_camera}


def associate_new(
    work: FrameContext, plate: str, history: TrackHistory, detections: Mapping[str, Seen]
) -> TrackHistory:
    """The history after the sensors or cameras of a plate saw the first frame, in which it has no targets."""
    looks = looks_of(work, plate, detections)
    return Several(work, work.engine.plates[plate], None, {}).associate_marginal(history, looks).history


@dataclass(frozen=True, eq=False)
class SharedDetections:
    """Detections that the targets of a plate are given.

    Attributes:
        rows: what its rows are given; None without any.
        others: its other targets, with what they are given.
        owners: (N,) whose each detection is.
        history: with the tentative tracks, or what was learnt of all detections.
        events: cameras that were knocked.
    """

    rows: RowAssociation | None
    others: Mapping[str, TargetState]
    owners: tuple[str | None, ...]
    history: TrackHistory
    events: tuple[CameraKnocked, ...] = ()


@dataclass(frozen=True, eq=False)
class Several:
    """The targets of a plate before a look: those that are rows come first.

    Attributes:
        work: the frame.
        compiled: the plate.
        rows: its table; None without any.
        others: its other targets.
    """

    work: FrameContext
    compiled: CompiledPlate
    rows: Rows | None
    others: Mapping[str, TargetState]

    def assign(self, history: TrackHistory, detections: Found | None) -> SharedDetections:
        """The best assignment of the detections to targets and tentative tracks."""
        compiled, names = self.compiled, self.names
        agent, rule = next(iter(compiled.association_rules.items()))
        sightings = Found.none() if detections is None else detections
        waiting = tentative_tracks(compiled, history)
        expecting, previous = predictor(self.work, compiled), self._tracks().and_tentative(waiting)
        expected = TrackArrays(*expecting(previous.mean, previous.covariance), previous.observed)
        by_labels = {}
        for row, mixture in self._in_modes(expecting.elapsed).items():
            expected.mean[row], expected.covariance[row] = mixture.moments
            if rule.label is not None:
                by_labels[row] = mixture.log_gain(rule, sightings.labels)
        owner = assign_detections(rule, expected, sightings, self._log_looks, by_labels)
        assigned = own_detections(owner, sightings.boxes, sightings.scores)
        updated, refiltered = follow_owners(rule, previous, expected, owner, assigned, expecting)
        if waiting:
            tentative = advance_tentative(compiled, waiting, updated, assigned, detections is not None)
            if rule.label is not None:
                waiting_owners = owner[-len(waiting) :].tolist()
                whose = [sightings.labels[k] if k != UNASSIGNED else "" for k in waiting_owners]
                tentative = label_tentative(waiting, tentative, rule.label.log(whose))
            history = evolve(history, candidates={**history.candidates, compiled.plate.name: tentative})
        is_given, count, rows = owner != UNASSIGNED, self.count, None
        history = self._record_refusals(
            history, (expected.mean, expected.covariance), (is_given, owner), sightings
        )
        if self.rows is not None:
            live = slice(count)
            rows = RowAssociation(
                updated.mean[live],
                updated.covariance[live],
                assigned[live],
                is_given[live],
                self.rows.columns.existence,
                updated.observed[live],
                sightings.boxes,
                looked=detections is not None,
            )
        states = {}
        for row, (target, state) in enumerate(self.others.items(), count):
            detection = None if detections is None else assigned[row : row + is_given[row]]
            labels = {}
            if rule.label is not None and is_given[row]:
                labels = {agent: rule.label.told([sightings.labels[owner[row]]])}
            state = give_detections(state, dict.fromkeys(compiled.association_rules, detection), labels)
            states[target] = remember_detections(state, agent, updated.observed[row], refiltered.get(row))
        return SharedDetections(rows, states, name_owners(owner, names, len(sightings.boxes)), history)

    def expect(self) -> Crowd:
        """The targets as they are expected in the frame, before a sensor looks."""
        tracks, expecting = self._tracks(), predictor(self.work, self.compiled)
        mean, covariance = expecting(tracks.mean, tracks.covariance)
        modes = self._in_modes(expecting.elapsed)
        for row, mixture in modes.items():
            mean[row], covariance[row] = mixture.moments
        return Crowd(mean, covariance, self._existence(), self.names, self._log_looks, modes)

    def associate_marginal(self, history: TrackHistory, looks: Mapping[str, Found]) -> SharedDetections:
        """Share what sensors saw by probability among targets that exist with one and unconfirmed tracks.

        `looks` has the sensors that looked, taken one after the other, each with what those before it told.
        """
        compiled, frames, plate = self.compiled, self.work.cache.frames, self.compiled.plate.name
        rules = {agent: rule for agent in compiled.sensors if (rule := CrowdRule.of(compiled, agent))}
        first, *_, last_agent = (*rules, *rules)
        crowd, cameras = self.expect(), (history.watches.get(plate, {}), errors_at(self.work, history))
        targets = tuple(self.names), crowd.mean
        watched = Watched.watch(compiled, self.work.frame.index, cameras, looks, targets)
        mean, covariance = watched.move(*crowd.moments)
        crowd = evolve(crowd, mean=mean, covariance=covariance)
        no_tracks = DetectionModel(UnconfirmedTracks.none(mean.shape[1]))
        detection_model = watched.move_tracks(history.detection_models.get(plate) or no_tracks)
        seen_first = looks.get(first)
        crowd, detection_model = expect_crowd(rules[first], frames, crowd, detection_model, seen_first)
        links = dict.fromkeys(rules, given_nothing(crowd, detection_model))
        for agent in [name for name in rules if name in looks]:
            rule = evolve(rules[agent], sensor=rules[agent].sensor.at(frames, watched.copy))
            sensor = None if agent == first else agent
            model = detection_model.by(sensor)
            links[agent] = associate_marginal(rule, frames.current, crowd, model, looks[agent])
            detection_model = detection_model.after(sensor, links[agent].detection_model)
            camera, mixed = rule.sensor.camera, links[agent].mixed
            if camera is not None and (numbers := camera.check(*crowd.moments, looks[agent], mixed)):
                self.work.cameras[camera.name] = numbers
            crowd = evolve(crowd, existence=links[agent].existence)
            if agent != last_agent:
                crowd = after_look(rule, crowd, looks[agent], links[agent])
        history = evolve(history, detection_models={**history.detection_models, plate: detection_model})
        rows, boxes, has_own = None, seen_first or Found.none(), np.diff(links[first].starts) > 0
        if rules[first].sensor.has_extent:
            history = self._record_refusals(history, (mean, covariance), (has_own, links[first].owner), boxes)
        if self.rows is not None:
            rows = self._given(mean, covariance, seen_first, links[first])
        owners = [
            name_owners(links[agent].owner, crowd.names, len(detections.values))
            for agent, detections in looks.items()
        ]
        by_agent = {agent: looks.get(agent) for agent in rules}
        states = {
            target: self._told(watched.move_target(state), row, by_agent, links, float(crowd.existence[row]))
            for row, (target, state) in enumerate(self.others.items(), self.count)
        }
        if watched.watches:
            watches = {**history.watches, plate: watched.watches}
            history = evolve(history, watches=watches, errors=watched.errors)
        return SharedDetections(rows, states, tuple(chain.from_iterable(owners)), history, watched.events)

    def _record_refusals(
        self,
        history: TrackHistory,
        expected: tuple[Floats, Floats],
        assigned: tuple[Bools, Ints],
        detections: Found,
    ) -> TrackHistory:
        """Record which bounds refused detections beside targets without one."""
        step, tracks, sizes = self.work.frame.index, (self.names, self.rows), (*assigned, detections.boxes)
        return record_refusals(self.compiled, step, history, tracks, expected, sizes)

    def _existence(self) -> Floats:
        """(T,) probability that each exists, as of the last frame."""
        of_states = [1.0 if state.existence is None else state.existence for state in self.others.values()]
        if self.rows is None:
            return np.array(of_states, dtype=np.float64)
        of_rows = self.rows.columns.existence
        return np.concatenate([of_rows, of_states]) if of_states else of_rows

    def _given(
        self, mean: Floats, covariance: Floats, detections: Found | None, association: MarginalAssociation
    ) -> RowAssociation:
        """The share of the rows in what their only sensor found; None where it did not look."""
        assert self.rows is not None
        live, sightings = slice(self.count), Found.none() if detections is None else detections
        return RowAssociation(
            mean[live],
            covariance[live],
            own_detections(association.owner[live], sightings.boxes, sightings.scores),
            np.diff(association.starts[: self.count + 1]) > 0,
            association.existence[live],
            self.rows.columns.observed,
            sightings.boxes,
            association,
            detections is not None,
        )

    def _told(
        self,
        state: TargetState,
        row: int,
        detections: Mapping[str, Found | None],
        associations: Mapping[str, MarginalAssociation],
        existence: float,
    ) -> TargetState:
        """A target with what its agents are given, and how probably it exists."""
        by_agent: dict[str, Floats | None] = {}
        labels: dict[str, Floats] = {}
        for agent, sightings in detections.items():
            if sightings is None:  # nobody looked
                by_agent[agent] = None
                continue
            span = slice(*associations[agent].starts[row : row + 2])
            columns, weights = associations[agent].columns[span], associations[agent].weights[span]
            parts = [sightings.values[columns], sightings.scores[columns]]
            if self.compiled.plate.spec.associate == "marginal":
                parts.append(weights)
            by_agent[agent] = np.column_stack(parts)
            rule = self.compiled.association_rules[agent].label
            if rule is not None and len(columns):
                labels[agent] = rule.told([sightings.labels[column] for column in columns.tolist()])
        return evolve(give_detections(state, by_agent, labels), existence=existence)

    @property
    def count(self) -> int:
        """The number of rows."""
        return 0 if self.rows is None else len(self.rows.ids)

    @property
    def names(self) -> Sequence[str]:
        """All of them."""
        row_ids = () if self.rows is None else self.rows.ids
        return (*row_ids, *self.others) if self.others else row_ids

    def _tracks(self) -> TrackArrays:
        """Their beliefs after the last frame, and what is remembered of their detections."""
        agent, rule = next(iter(self.compiled.association_rules.items()))
        rows, size = None if self.rows is None else self.rows.columns, len(self.compiled.moments.fields)
        if rows is not None and not self.others:
            return TrackArrays(rows.mean, rows.covariance, rows.observed)
        states = self.others.values()
        beliefs = [state.belief for state in states]
        width = first_observed(rule, np.empty((0, 4)), size).shape[1]
        moments = [moments_of(belief) for belief in beliefs]
        observed = [
            remembered(rule, state.references.get(agent, {}), mean)
            for state, (mean, _) in zip(states, moments, strict=True)
        ]
        added = TrackArrays(
            np.array([mean for mean, _ in moments]).reshape(-1, size),
            np.array([covariance for _, covariance in moments]).reshape(-1, size, size),
            np.array(observed).reshape(len(states), width),
        )
        if rows is None:
            return added
        pairs = (rows.mean, added.mean), (rows.covariance, added.covariance), (rows.observed, added.observed)
        return TrackArrays(*(np.concatenate(pair) for pair in pairs))

    def _in_modes(self, elapsed: float) -> dict[int, ExpectedInModes]:
        """Row -> the target as it is expected, a Gaussian for each mode, of targets that have modes."""
        compiled = self.compiled
        if compiled.modes is None:
            return {}
        motion = self.work.confined(compiled.motion)
        settings = getattr(compiled.belief, "settings", None)
        gaussian = settings if isinstance(settings, Gaussian) else Gaussian(filter="extended")
        beliefs = enumerate((state.belief for state in self.others.values()), self.count)
        return {row: expect(belief, motion, elapsed, gaussian) for row, belief in beliefs}

    def _log_looks(self, rows: Ints, boxes: Floats) -> Floats:
        """(M,) log-likelihoods of boxes (M, 4) by what targets look like; 0 of tracks that nobody knows.

        Whose they are is in `rows` (M,), in order.
        """
        names, log = self.names, np.zeros(len(boxes))
        own_rows, firsts = np.unique(rows[rows < len(names)], return_index=True)
        starts = np.append(firsts, np.count_nonzero(rows < len(names)))
        states = [*self.others.values()]
        by_kind: dict[tuple[str, ...], list[int]] = {}
        for place, row in enumerate(own_rows.tolist()):
            kind: tuple[str, ...] = () if row < self.count else tuple(states[row - self.count].references)
            by_kind.setdefault(kind, []).append(place)
        for kind, places in by_kind.items():
            group = own_rows[places]
            if self.rows is not None and group[0] < self.count:
                memories = {
                    agent: ReferenceRows.some(memory, group) for agent, memory in self.rows.references.items()
                }
            else:
                references = [states[row - self.count].references for row in group.tolist()]
                memories = {agent: ReferenceRows.of([entry[agent] for entry in references]) for agent in kind}
            indices = np.concatenate([np.arange(starts[place], starts[place + 1]) for place in places])
            sizes = np.cumsum([0, *(starts[place + 1] - starts[place] for place in places)])
            targets = [names[row] for row in group.tolist()]
            log[indices] = score_looks(self.work, self.compiled, targets, memories, boxes[indices], sizes)
        return log


def _expected_boxes(work: FrameContext, targets: Targets, names: Sequence[str]) -> Floats:
    """(K, 4) the boxes that targets are expected to have in this frame."""
    boxes = []
    for target in names:
        mean, covariance = moments_of(targets[target].belief)
        compiled = work.plate_of(target)
        mean, _ = predictor(work, compiled)(mean[None], covariance[None])
        boxes.append(compiled.boxes(mean, work.frame)[0])
    return np.array(boxes).reshape(-1, 4)
