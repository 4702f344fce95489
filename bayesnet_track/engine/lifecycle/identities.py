"""The stage that keeps a probability of who is who, for plates with `identity`.

It comes after the targets of the frame are known, and changes none of them: detections that several targets
may have caused are taken as they are, and `adapt.identities` sums over whose they were. Its own prediction of
the members of a meeting starts with their beliefs before they met.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.identities import Entangled, PlateIdentities, compose, keep_live
from bayesnet_track.adapt.meetings import (
    FAR_D2,
    LAPSE,
    MOST_DETECTIONS,
    MOST_MEMBERS,
    Meeting,
    MeetingDetections,
    Placing,
    SensorRates,
    advance,
    close_pairs,
    gap_class,
    halves_of_d2,
    join_meetings,
    open_meeting,
    place_tracks,
    spread_of_shared,
)
from bayesnet_track.belief.motion.modes import moments_of
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.assigning import score_looks
from bayesnet_track.engine.lifecycle.association import Associated
from bayesnet_track.engine.lifecycle.sharing import Predict, predictor
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.targets import Targets
from bayesnet_track.graph.settings.lifecycle import Identity
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import CandidateConfirmed, Reacquired, Returned
from bayesnet_track.journal.events.statuses import IdentityDoubtful
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve

NEAR_D2 = 18.0
"""Squared distance of two targets, in sds of what their detections differ by, below which they are close."""
LONGEST = 300
"""Frames after which a meeting is settled as it is."""
SURE = 0.99
"""Probability from which on an identity is not doubtful."""
PLAIN = 0.9995
"""Probability from which on who is who is settled at once, two frames after parting."""
MOST_TRACKS = 6


@dataclass(frozen=True, eq=False)
class LiveTracks:
    """The tracks of a plate.

    Attributes:
        ids: T targets.
        mean: (T, D) of their beliefs.
        covariance: (T, D, D).
        started: (T,) frame of birth.
    """

    ids: tuple[str, ...]
    mean: Floats
    covariance: Floats
    started: Ints

    @property
    def index(self) -> dict[str, int]:
        """Target -> its row."""
        return {target: row for row, target in enumerate(self.ids)}


def track_identities(
    work: FrameContext, previous: Targets, associated: Associated, outcome: Outcome
) -> Outcome:
    """The outcome with who may be whom; `previous` are the targets as they were before the frame."""
    start = work.engine.clock()
    memory, events = dict(outcome.state.identities), list[Event]()
    doubts: dict[str, Mapping[str, float]] = {}
    for plate, compiled in work.engine.plates.items():
        rule = compiled.plate.spec.identity
        if rule is None:
            continue
        identities = memory.get(plate, PlateIdentities())
        identifying = Identifying(work, compiled, rule, previous, _tracks_of(compiled, previous))
        memory[plate], placings, plate_events = identifying.after(identities, associated, outcome)
        events += plate_events
        composed = memory[plate].entangled
        for placing in placings:
            composed = compose(composed, placing, SURE)
        for entangled in composed:
            doubts.update((track, entangled.of(track)) for track in entangled.tracks)
    work.charge("life", start)
    state = evolve(outcome.state, identities=memory)
    metrics = outcome.metrics.with_identities(doubts) if doubts else outcome.metrics
    events_after = (*outcome.events, *events)
    return evolve(outcome, state=state, metrics=metrics, events=events_after, seconds=work.seconds)


def _tracks_of(compiled: CompiledPlate, targets: Targets) -> LiveTracks:
    """The tracks of a plate with their beliefs."""
    name = compiled.plate.name
    width = len(compiled.moments.fields)
    ids: list[str] = []
    means, covariances, start_frames = [np.empty((0, width))], [np.empty((0, width, width))], list[int]()
    for rows in targets.gaussians:
        if rows.rule.plate == name:
            ids += rows.ids
            means.append(rows.columns.mean)
            covariances.append(rows.columns.covariance)
            start_frames += rows.columns.started.tolist()
    for target in targets.order:
        state = targets[target]
        if state.plan.target == name:
            mean, covariance = moments_of(state.belief)
            ids.append(target)
            means.append(mean[None])
            covariances.append(covariance[None])
            start_frames.append(state.started)
    return LiveTracks(
        tuple(ids), np.concatenate(means), np.concatenate(covariances), np.array(start_frames, dtype=np.int64)
    )


@dataclass(frozen=True, eq=False)
class Identifying:
    """One plate in one frame.

    Attributes:
        work: the frame.
        compiled: the plate.
        rule: its `identity`.
        targets: the targets before the frame.
        before: those of the plate, as columns.
    """

    work: FrameContext
    compiled: CompiledPlate
    rule: Identity
    targets: Targets
    before: LiveTracks

    def after(
        self, memory: PlateIdentities, associated: Associated, outcome: Outcome
    ) -> tuple[PlateIdentities, list[Placing], list[Event]]:
        """Memory after the frame, who is who in meetings that go on, and what the log says."""
        plate, frame = self.compiled.plate.name, self.work.frame.index
        expecting = predictor(self.work, self.compiled)
        mean, covariance = expecting(self.before.mean, self.before.covariance)
        expected = evolve(self.before, mean=mean, covariance=covariance)
        batch, events = associated.found.get(plate, {}).get(""), list[Event]()
        tracks = _tracks_of(self.compiled, Targets.of(outcome.state.targets))
        entangled = keep_live(memory.entangled, frozenset(tracks.ids), SURE)
        entangled = (*entangled, *_recognised(outcome.events, entangled, tracks.ids))
        if batch is None:
            waiting = tuple(_predicted(meeting, expecting) for meeting in memory.meetings)
            return evolve(memory, meetings=waiting, entangled=entangled), [], events
        detections = PlateDetections.of(self.compiled, batch.boxes, associated.owners.get(plate, ()))
        unseen = np.array([memory.unseen.get(target, 0) + 1 for target in self.before.ids], dtype=np.int64)
        meetings, refused = self._meet(memory, expected, detections, unseen)
        rates = self._rates(memory.rates, meetings, expected, detections, unseen)
        going_on: list[Meeting] = []
        placings: list[Placing] = []
        for meeting in meetings:
            meeting = self._advanced(_predicted(meeting, expecting), expected, detections, rates)
            placing = self._placed(meeting, tracks, meetings)
            frames_apart = frame - meeting.last_near
            is_plain = frames_apart >= 2 and placing is not None and placing.probability[0] >= PLAIN - LAPSE
            if placing is None:
                continue
            if is_plain or frames_apart >= self.rule.settle or frame - meeting.since >= LONGEST:
                entangled = compose(entangled, placing, SURE)
                events += self._doubts(meeting, placing, refused)
            else:
                going_on.append(meeting)
                placings.append(placing)
        without = {
            target: int(count)
            for target, count in zip(self.before.ids, unseen.tolist(), strict=True)
            if target not in detections.own
        }
        open_ones = {member for meeting in going_on for member in meeting.members}
        refusals = tuple(pair for pair in refused if pair[1] in open_ones)
        return PlateIdentities(tuple(going_on), entangled, rates, without, refusals), placings, events

    def _meet(
        self, memory: PlateIdentities, expected: LiveTracks, detections: PlateDetections, unseen: Ints
    ) -> tuple[list[Meeting], tuple[tuple[str, str], ...]]:
        """The meetings of the frame: those of before, with others that come close, and new ones."""
        frame, meetings = self.work.frame.index, list(memory.meetings)
        refused = dict.fromkeys(memory.refused)
        meeting_of = {member: meeting for meeting in meetings for member in meeting.members}
        rows = self.before.index

        def opened(target: str) -> Meeting:
            row = rows[target]
            gone = unseen[row : row + 1] - 1
            mean, covariance = self.before.mean[row : row + 1], self.before.covariance[row : row + 1]
            return open_meeting([target], frame, mean, covariance, [self._references(target)], gone)

        for first, second in _close_pairs(expected, self.compiled, memory.rates, unseen):
            a, b = (meeting_of.get(name) or opened(name) for name in (first, second))
            if a is b:
                merged = evolve(a, last_near=frame)
            elif len(a.members) + len(b.members) > MOST_MEMBERS:
                refused.update({(first, second): None, (second, first): None})
                continue
            else:
                merged = evolve(join_meetings(a, b), last_near=frame)
            meetings = [meeting for meeting in meetings if meeting is not a and meeting is not b]
            meetings.append(merged)
            meeting_of.update(dict.fromkeys(merged.members, merged))
        return meetings, tuple(refused)

    def _references(self, target: str) -> Mapping[str, Mapping[str, Floats]]:
        """References that the agents remember of a target's looks."""
        if not self.compiled.looks or self.rule.appearance <= 0.0:
            return {}
        references = self.targets[target].references
        return {agent: references[agent] for agent in self.compiled.looks if agent in references}

    def _rates(
        self,
        rates: SensorRates,
        meetings: Sequence[Meeting],
        expected: LiveTracks,
        detections: PlateDetections,
        unseen: Ints,
    ) -> SensorRates:
        """The rates with this frame's targets that are close to no other."""
        met = {member for meeting in meetings for member in meeting.members}
        rows_apart = [row for row, target in enumerate(expected.ids) if target not in met]
        detected_rows = [row for row in rows_apart if expected.ids[row] in detections.own]
        columns = [detections.own[expected.ids[row]] for row in detected_rows]
        spread = expected.covariance[detected_rows, :4, :4] + detections.variances[columns][
            :, :, None
        ] * np.eye(4)
        d2, _ = halves_of_d2(detections.boxes[columns] - expected.mean[detected_rows, :4], spread)
        fresh = [row for row in rows_apart if unseen[row] == 1]
        hits = len({*fresh}.intersection(detected_rows))
        free = sum(owner is None for owner in detections.owners)
        return rates.learn(d2, unseen[detected_rows], (hits, len(fresh)), free)

    def _advanced(
        self, meeting: Meeting, expected: LiveTracks, detections: PlateDetections, rates: SensorRates
    ) -> Meeting:
        """A meeting, predicted to this frame, after the frame's detections."""
        rows, members = expected.index, {*meeting.members}
        spread = meeting.covariance[:, :, None, :4, :4] + detections.variances[:, None] * np.eye(4)
        d2, _ = halves_of_d2(detections.boxes - meeting.mean[:, :, None, :4], spread)
        scale2 = rates.scale2[gap_class(meeting.unseen + 1)][..., 0]
        nearest = (d2[..., 0] / scale2[:, :, None]).min(axis=(0, 1), initial=np.inf)
        area = float(self.work.frame.width * self.work.frame.height)
        sides = np.maximum(meeting.mean[0, :, 2:4].mean(axis=0), 1.0)
        log_clutter = np.log(max(rates.clutter[0] / rates.clutter[1], 1e-3) / area / float(sides.prod()))
        columns: list[int] = []
        log_else: list[float] = []
        for column in np.argsort(nearest, kind="stable").tolist():
            if nearest[column] > FAR_D2 / 2.0 or len(columns) == MOST_DETECTIONS:
                break
            owner = detections.owners[column]
            log = log_clutter
            if owner in rows and owner not in members:
                row = rows[owner]
                if expected.started[row] < meeting.since:
                    continue  # of a target that is close to none of them
                log = max(
                    log, detections.log_density(column, expected.mean[row], expected.covariance[row], rates)
                )
            columns.append(column)
            log_else.append(log)
        boxes = detections.boxes[columns]
        looks = self._looks(meeting, boxes)
        variances = detections.variances[columns] + spread_of_shared(meeting, boxes)
        return advance(meeting, MeetingDetections(boxes, variances, looks, np.array(log_else)), rates)

    def _looks(self, meeting: Meeting, boxes: Floats) -> Floats:
        """(n, M) log-likelihoods of what members looked like before they met, at boxes (M, 4)."""
        looks = np.zeros((len(meeting.members), len(boxes)))
        live = [name for name in meeting.members if name in self.work.net.targets]
        rows = [row for row, references in enumerate(meeting.references) if references]
        if not (len(boxes) and live and rows):
            return looks
        agents = meeting.references[rows[0]]
        memories = {agent: [meeting.references[row][agent] for row in rows] for agent in agents}
        # An ended member is asked about in the name of one that lives: only draws go by it.
        names = [name if name in live else live[0] for name in (meeting.members[row] for row in rows)]
        starts = np.arange(len(rows) + 1) * len(boxes)
        log = score_looks(self.work, self.compiled, names, memories, np.tile(boxes, (len(rows), 1)), starts)
        looks[rows] = self.rule.appearance * log.reshape(len(rows), len(boxes))
        return looks

    def _placed(self, meeting: Meeting, live: LiveTracks, meetings: Sequence[Meeting]) -> Placing | None:
        """The member that each track is: of members that live, and of tracks that began meanwhile."""
        rows = live.index
        tracks = [name for name in meeting.members if name in rows]
        if not tracks:
            return None
        met = {member for open_meeting in meetings for member in open_meeting.members}
        heavy = meeting.log_weight > np.log(0.01)
        for name, row in rows.items():
            if name in met or live.started[row] < meeting.since or len(tracks) == MOST_TRACKS:
                continue
            deviations = live.mean[row, :4] - meeting.mean[heavy][..., :4]
            spread = live.covariance[row, :4, :4] + meeting.covariance[heavy][..., :4, :4]
            if (halves_of_d2(deviations, spread)[0][..., 0] < FAR_D2 / 2.0).any():
                tracks.append(name)
        track_rows = [rows[name] for name in tracks]
        return place_tracks(meeting, tracks, live.mean[track_rows], live.covariance[track_rows])

    def _doubts(
        self, meeting: Meeting, placing: Placing, refused: Sequence[tuple[str, str]]
    ) -> list[IdentityDoubtful]:
        """Events of a meeting that is settled."""
        named, shares = placing.named(), placing.probability
        doubts: list[IdentityDoubtful] = []
        reported: set[tuple[str, str]] = set()
        for place, track in enumerate(placing.tracks):
            totals: dict[str, float] = {}
            for names, share in zip(named, shares.tolist(), strict=True):
                totals[names[place]] = totals.get(names[place], 0.0) + share
            rivals = {name: share for name, share in totals.items() if name != track}
            rival = max(rivals, key=rivals.__getitem__, default="")
            if not rival or rivals[rival] < self.rule.report_above or (rival, track) in reported:
                continue
            reported.add((track, rival))
            is_own = np.array([names[place] == track for names in named])
            is_other = np.array([names[place] == rival for names in named])
            keeps = totals.get(track, 0.0)
            nats = float(np.log(max(keeps, 1e-300)) - np.log(rivals[rival]))
            looks = _mean_of(placing.looks, shares, is_own) - _mean_of(placing.looks, shares, is_other)
            mutual = (rival, track) in {
                (name, name_of)
                for names, is_it in zip(named, is_other.tolist(), strict=True)
                if is_it
                for name, name_of in zip(placing.tracks, names, strict=True)
            }
            nearby = tuple(dict.fromkeys(name for name, member in refused if member in meeting.members))
            doubts.append(
                IdentityDoubtful(
                    self.work.frame.index,
                    track,
                    rival,
                    meeting.since,
                    rivals[rival],
                    keeps,
                    looks,
                    float(np.clip(nats - looks, -99.0, 99.0)),
                    mutual,
                    nearby,
                )
            )
        return doubts


@dataclass(frozen=True, eq=False)
class PlateDetections:
    """The detections of a plate in a frame, and whose the tracker takes them for.

    Attributes:
        boxes: (N, 4).
        variances: (N, 4) of their errors.
        owners: of each the target, a tentative track, or None.
        own: target -> its detection.
    """

    boxes: Floats
    variances: Floats
    owners: tuple[str | None, ...]
    own: Mapping[str, int]

    @classmethod
    def of(cls, compiled: CompiledPlate, boxes: Floats, owners: tuple[str | None, ...]) -> PlateDetections:
        """With the errors that the plate's first agent names."""
        agent, rule = next(iter(compiled.association_rules.items()))
        named = (*owners, *[None] * (len(boxes) - len(owners)))
        column_of = {owner: column for column, owner in enumerate(named) if owner}
        variances = rule.variances(boxes) * compiled.plate.agent(agent).temperature
        return cls(boxes, variances, named, column_of)

    def log_density(self, column: int, mean: Floats, covariance: Floats, rates: SensorRates) -> float:
        """Log density of a detection that is of a target expected so."""
        spread = covariance[:4, :4] + np.diag(self.variances[column])
        d2, log = halves_of_d2(self.boxes[column] - mean[:4], spread)
        scale2 = rates.scale2[0]
        return float(-np.sum(d2 / scale2 + log + np.log(scale2)) - 2.0 * np.log(2.0 * np.pi))


def _predicted(meeting: Meeting, expecting: Predict) -> Meeting:
    shape = meeting.mean.shape
    mean, covariance = expecting(
        meeting.mean.reshape(-1, shape[-1]), meeting.covariance.reshape(-1, shape[-1], shape[-1])
    )
    return evolve(meeting, mean=mean.reshape(shape), covariance=covariance.reshape(*shape, shape[-1]))


def _close_pairs(
    expected: LiveTracks, compiled: CompiledPlate, rates: SensorRates, unseen: Ints
) -> list[tuple[str, str]]:
    """Targets that expect each other's detections, the closest first."""
    count = len(expected.ids)
    if count < 2:
        return []
    rule = next(iter(compiled.association_rules.values()))
    # At least what the graph names: it may have swapped by that.
    scale2 = np.maximum(rates.scale2[gap_class(unseen)][:, 0], 1.0)
    spread = expected.covariance[:, :4, :4] + rule.variances(expected.mean[:, :4])[:, :, None] * np.eye(4)
    pairs = close_pairs(expected.mean[:, :4], spread * scale2[:, None, None], NEAR_D2)
    return [(expected.ids[first], expected.ids[second]) for first, second in pairs]


def _recognised(
    events: Sequence[Event], entangled: Sequence[Entangled], live: Sequence[str]
) -> list[Entangled]:
    """Cases that re-identification leaves open, in the same form: a detection is a memory target, or new."""
    open_ones: list[Entangled] = []
    handled = {track for group in entangled for track in group.tracks}
    for event in events:
        if isinstance(event, Returned | Reacquired):
            recognition, name, rival = event.recognition, event.target, event.recognition.rival
        elif isinstance(event, CandidateConfirmed) and event.nearest is not None:
            recognition, name, rival = event.nearest, event.target, event.nearest.target
        else:
            continue
        if event.target in handled or event.target not in live:
            continue
        share = recognition.probability if name == recognition.target else 1.0 - recognition.probability
        rival_share = recognition.rival_probability if name == recognition.target else recognition.probability
        if share < SURE and rival_share > 0.0:
            pairs = sorted(((share, (name,)), (rival_share, (rival,))), key=lambda pair: -pair[0])
            total = share + rival_share
            names, shares = tuple(pair[1] for pair in pairs), tuple(pair[0] / total for pair in pairs)
            open_ones.append(Entangled((event.target,), names, shares))
            handled.add(event.target)
    return open_ones


def _mean_of(values: Floats, shares: Floats, selected: Floats) -> float:
    total = float(shares[selected].sum())
    return float((values[selected] * shares[selected]).sum() / total) if total > 0.0 else 0.0
