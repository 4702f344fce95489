"""Identities that follow each other as one track would: their number, their length, what may keep them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesnet_track.cli.findings import Finding

if TYPE_CHECKING:
    from bayesnet_track.journal.blocks import Course
    from bayesnet_track.journal.events.event import Event
    from bayesnet_track.journal.events.joins import Refusal

REACH_BOX = 3.0
"""A new identity continues an earlier one within so many box sides of where that was or was going."""
REACH_FRAMES = 60
"""And so soon after its last frame."""
PREDICTED = 10
"""For how many frames a target without a detection may be shown where it is expected."""
HIGH = 1.2
"""Identities per track from which on they stand out."""
MOST_SETTINGS = 3
"""Settings that are proposed for one plate."""


@dataclass(frozen=True)
class TargetIdentity:
    """One target of a run.

    Attributes:
        target: its id.
        first_frame: frame of the first detection that it was born of.
        born: frame in which its net started.
        start: (4,) centre box there, px.
        last_frame: last frame in which it was shown: neither lost nor hidden.
        end: (4,) centre box there, px.
        velocity: (2,) px a frame of its centre over its last frames.
        refusal: the detection that it was not given when it was lost or ended, or None.
    """

    target: str
    first_frame: int
    born: int
    start: Sequence[float]
    last_frame: int
    end: Sequence[float]
    velocity: Sequence[float]
    refusal: Refusal | None

    @property
    def frames(self) -> int:
        """Frames from the birth to the last in which it was shown."""
        return self.last_frame - self.born + 1

    def distance_box(self, successor: TargetIdentity) -> float:
        """Distance of a later identity's start from the end of this one, in box sides; else infinite."""
        gap = successor.born - self.last_frame
        if not 0 < gap <= REACH_FRAMES or successor.first_frame < self.first_frame:
            return math.inf
        refusal = self.refusal
        if refusal is not None and refusal.missed_frame <= successor.first_frame:
            place, sides = refusal.box, _sides(refusal.box)
            steps = successor.born - refusal.missed_frame + 1
            if successor.first_frame - refusal.missed_frame <= 2:
                return math.dist(successor.start[:2], place[:2]) / sides / steps
        places = [[self.end[k] + self.velocity[k] * steps for k in (0, 1)] for steps in (0, gap)]
        return min(math.dist(place, successor.start[:2]) for place in places) / _sides(self.end)


def _sides(box: Sequence[float]) -> float:
    return math.sqrt(max(box[2] * box[3], 1e-12))


def identities_of(events: Sequence[Event], courses: Mapping[str, Course]) -> list[TargetIdentity]:
    """The targets of a run that were born of detections and shown in a frame at least; courses with `box`."""
    from bayesnet_track.journal.events.joins import DetectionRefused
    from bayesnet_track.journal.events.lives import CandidateConfirmed, TargetDied, TargetStarted

    confirmed = {event.target: event for event in events if isinstance(event, CandidateConfirmed)}
    starts = {event.target: event for event in events if isinstance(event, TargetStarted)}
    died = {event.target: event for event in events if isinstance(event, TargetDied)}
    refused = {event.target: event.refusal for event in events if isinstance(event, DetectionRefused)}
    identities = []
    for target, birth in confirmed.items():
        course = courses.get(target)
        if target not in starts or course is None:
            continue
        visible = np.flatnonzero(~course.is_gone)
        start = starts[target]
        end, last_frame, velocity = start.box, start.frame, (0.0, 0.0)
        if len(visible):
            boxes, frames = np.asarray(course.block.columns["box"], dtype=np.float64).T, course.frame
            last_row, earlier = int(visible[-1]), max(int(visible[-1]) - 3, 0)
            end, last_frame = boxes[last_row].tolist(), int(frames[last_row])
            steps = max(int(frames[last_row] - frames[earlier]), 1)
            velocity = ((boxes[last_row, :2] - boxes[earlier, :2]) / steps).tolist()
        refusal, death = refused.get(target), died.get(target)
        # Frames after its last detection are no frames of its own: there it was only predicted.
        if death is not None and death.reason != "lost":
            last_frame = min(last_frame, death.frame - death.frames)
        if refusal is not None and 0 <= last_frame - refusal.missed_frame < PREDICTED:
            last_frame = refusal.missed_frame - 1
        last_frame = max(last_frame, start.frame)
        identities.append(
            TargetIdentity(
                target, birth.first_frame, start.frame, start.box, last_frame, end, velocity, refusal
            )
        )
    return identities


def successors_of(identities: Sequence[TargetIdentity]) -> dict[str, TargetIdentity]:
    """Target -> the identity that goes on with what it followed, the nearest pairs first; one to one."""
    pairs = sorted(
        (distance, later.born, earlier.target, later.target)
        for earlier in identities
        for later in identities
        if later is not earlier and (distance := earlier.distance_box(later)) <= REACH_BOX
    )
    by_target = {identity.target: identity for identity in identities}
    successors: dict[str, TargetIdentity] = {}
    continued: set[str] = set()
    for _, _, earlier_target, later_target in pairs:
        if earlier_target not in successors and later_target not in continued:
            successors[earlier_target] = by_target[later_target]
            continued.add(later_target)
    return successors


def find_identities(
    identities: Sequence[TargetIdentity], graph: Mapping[str, Any], plate: str
) -> Iterator[Finding]:
    """One finding where the identities of a plate follow each other; `graph` is its plain data."""
    from bayesnet_track.journal.text.wording import plural

    successors = successors_of(identities)
    if not successors:
        return
    tracks = len(identities) - len(successors)
    cut = [identity for identity in identities if identity.target in successors]
    refusals = [identity.refusal for identity in cut if identity.refusal is not None]
    if len(identities) / tracks < HIGH and not refusals:
        return
    example = next((identity for identity in cut if identity.refusal is not None), cut[0])
    median = float(np.median([identity.frames for identity in identities]))
    count = len(identities)
    text = (
        f"{count} identities are {tracks} track{'' if tracks == 1 else 's'} by where they end and start: "
        f"{count / tracks:.1f} a track, {plural(median, 'frame')} long (median); {len(refusals)} of the "
        f"{len(cut)} that go on as another ended beside a detection that no target had"
    )
    refusal = example.refusal
    if refusal is not None:
        text += (
            f", first in frame {refusal.missed_frame}: {refusal.distance_px:.0f} px away, "
            f"{' and '.join(refusal.bounds())}"
        )
    frame = example.last_frame if refusal is None else refusal.missed_frame
    settings = [*_settings(refusals, graph, plate), *_longer(cut, successors, graph, plate)]
    yield Finding(
        example.target, text, None, None if refusal is None else refusal.agent, frame, "identities",
        tuple(settings[:MOST_SETTINGS]),
    )  # fmt: skip


def _settings(refusals: Sequence[Refusal], graph: Mapping[str, Any], plate: str) -> Iterator[tuple[str, ...]]:
    """Settings with which all refused detections, or those with a value that would do, had been given."""
    if not refusals:
        return
    agent = refusals[0].agent
    place = f"{plate}.nodes.{agent}.agent.detection"
    reaches = [reach for refusal in refusals if (reach := refusal.needed_continue_box()) is not None]
    if reaches:
        yield (f"{place}.continue_box={max(reaches):g}",)
    gates = [needed for refusal in refusals if (needed := refusal.needed())]
    bounds = {
        key: (min if key == "min_overlap" else max)(needed[key] for needed in gates if key in needed)
        for key in ("gate", "min_overlap", "appearance")
        if any(key in needed for needed in gates)
    }
    if bounds:
        yield tuple(f"{place}.{key}={value:.12g}" for key, value in bounds.items())
    factors = [
        math.sqrt(refusal.d2 / refusal.d2_limit)
        for refusal in refusals
        if refusal.is_beyond_gate and refusal.d2
    ]
    if factors:
        yield from _more_motion(graph, plate, max(math.ceil(max(factors) * 10) / 10, 1.1))


def _more_motion(graph: Mapping[str, Any], plate: str, factor: float) -> Iterator[tuple[str, ...]]:
    """The motion's own spread, by a factor."""
    nodes = graph[plate]["nodes"]
    root = next(name for name, node in nodes.items() if "parent" not in node)
    motion = nodes[root].get("motion")
    if not isinstance(motion, dict):
        return
    name, settings = next(iter(motion.items()))
    for key in ("sd_velocity_px", "sd_px"):
        value = (settings or {}).get(key)
        path = f"{plate}.nodes.{root}.motion.{name}.{key}"
        if isinstance(value, int | float):
            yield (f"{path}={float(f'{value * factor:.3g}'):g}",)
            return
        if isinstance(value, dict) and value:
            scaled = {field: float(f"{number * factor:.3g}") for field, number in value.items()}
            yield (f"{path}={{{', '.join(f'{field}: {number:g}' for field, number in scaled.items())}}}",)
            return


def _longer(
    cut: Sequence[TargetIdentity],
    successors: Mapping[str, TargetIdentity],
    graph: Mapping[str, Any],
    plate: str,
) -> Iterator[tuple[str, ...]]:
    """A later end, where identities ended before their successors' first detection."""
    unseen = graph[plate].get("death", {}).get("unseen_frames")
    gaps = [
        successors[identity.target].first_frame - identity.last_frame
        for identity in cut
        if identity.refusal is None
    ]
    if unseen is not None and gaps and max(gaps) >= unseen:
        yield (f"{plate}.death.unseen_frames={max(gaps) + 1}",)
