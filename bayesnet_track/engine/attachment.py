"""Targets that others may carry: by whom, in which order they are filtered, and what is reported of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesnet_track.adapt.joins import CarriedHypotheses, JoinMemory, PairMemory
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.belief.motion.delayed import Attached, with_carried, without_carried
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.filtering import Filtered, Ride
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Attachment
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import AttachmentChanged
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.numerics.arrays import Floats

CARRIED, FREE = 0.5, 0.3
"""Probability above which a target is reported as carried, and at or below which no longer."""

Carriers = Mapping[str, tuple[str, Attachment]]
"""Target that may be carried -> by whom, and how."""


def carriers_of(work: FrameContext, memory: JoinMemory) -> Carriers:
    """By whom each target may be carried: the one that carries it, else the one that overlaps it most."""
    ranked: dict[str, tuple[tuple[bool, float], str, Attachment]] = {}
    for (carrier, target), join in work.net.joins.items():
        settings = work.engine.joins[join.rule].attachment
        if settings is None:
            continue
        pair = memory.pairs.get((carrier, target), PairMemory())
        rank = (memory.carriers.get(target, ("", 0))[0] == carrier, pair.overlap)
        if target not in ranked or rank > ranked[target][0]:
            ranked[target] = (rank, carrier, settings)
    return {target: (carrier, settings) for target, (_, carrier, settings) in ranked.items()}


@dataclass(frozen=True, eq=False)
class Rides:
    """Possible carriers of the targets in one frame.

    Attributes:
        work: the frame's.
        memory: what is remembered of joins.
        carriers: by whom each target may be carried.
    """

    work: FrameContext
    memory: JoinMemory
    carriers: Carriers

    @staticmethod
    def of(work: FrameContext, memory: JoinMemory) -> Rides:
        """The rides of the frame."""
        return Rides(work, memory, carriers_of(work, memory))

    def carriers_first(self, targets: Iterable[str]) -> list[str]:
        """The targets in their order, but one that may be carried comes after its carrier."""
        order: list[str] = []
        for target in targets:
            chain = [target]
            while chain[-1] in self.carriers:
                chain.append(self.carriers[chain[-1]][0])
            order += [name for name in reversed(chain) if name not in order]
        return order

    def ride(self, target: str, previous: TargetState, filtered: Mapping[str, Filtered]) -> Ride | None:
        """Motion of the target with its carrier, which was `filtered` before; None for one without."""
        if target not in self.carriers:
            return None
        carrier, settings = self.carriers[target]
        motion = Attached(
            self.work.plate_of(target).motion,
            _displacement(filtered[carrier], self.memory.centres.get(carrier)),
            settings.start,
            settings.stay,
            settings.sd_px,
        )
        carried = self.memory.carried.get(target)
        column = carried.hypotheses if carried is not None and carried.belief is previous.belief else None
        return Ride(motion, with_carried(particles(previous.belief), column))


def _displacement(carrier: Filtered, previous_centre: Floats | None) -> Floats:
    """(2,) how far the carrier's centre went, by its own evidence in both frames: so errors cancel out."""
    start = carrier.before.belief.mean[:2] if previous_centre is None else previous_centre
    return np.asarray(carrier.step.posterior.mean[:2] - start)


def particles(belief: Posterior) -> ParticleSet:
    """The belief, which must be of particles."""
    if not isinstance(belief, ParticleSet):
        raise TypeError(f"only particles can be joined, not {type(belief).__name__}")
    return belief


def without_ride(step: Step[Posterior]) -> tuple[Step[Posterior], CarriedHypotheses]:
    """The step of the target's own state, and which of its hypotheses are carried."""
    posterior, column = without_carried(particles(step.posterior))
    find = partial(_without_last, step)
    return replace(step, posterior=posterior, support=posterior, find_map=find), CarriedHypotheses(
        posterior, column
    )


def report_carried(
    frame: int,
    metrics: Mapping[str, JoinMetrics],
    carriers: Carriers,
    memory: JoinMemory,
    events: list[Event],
) -> JoinMemory:
    """Add to `events` who is carried now, and who no longer is."""
    carried_by = dict(memory.carriers)
    for name, (carrier, _) in carriers.items():
        probability = metrics[name].attached or 0.0
        if name not in carried_by and probability > CARRIED:
            carried_by[name] = (carrier, frame)
            events.append(AttachmentChanged(frame, name, carrier, True, probability, 0))
        elif name in carried_by and probability <= FREE:
            former, first_frame = carried_by.pop(name)
            events.append(AttachmentChanged(frame, name, former, False, probability, frame - first_frame))
    return replace(memory, carriers=carried_by)


def _without_last(step: Step[Posterior]) -> Floats:
    return step.map_state[:-1]
