"""Trajectories that a graph expects before it has seen anything: draws from the prior of its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.borders import confined, framed
from bayesnet_track.belief.motion.composed import Influences, compose_motion, deviations_of
from bayesnet_track.belief.motion.modes import modes_of
from bayesnet_track.engine.compiled import make_plate_motion
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.motion import Moving
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.timed_columns import TimedInput, values_at


@dataclass(frozen=True, eq=False)
class Simulated:
    """Trajectories drawn from the prior.

    Attributes:
        states: (T + 1, N, D) of N trajectories in T + 1 frames, the first one included.
        fields: names of the D columns: centre x, y, w, h in px, then those of the motion.
        modes: names of the modes, which the last column numbers; empty without modes.
    """

    states: Floats
    fields: tuple[str, ...]
    modes: tuple[str, ...] = ()

    @property
    def boxes(self) -> Floats:
        """(T + 1, N, 4) centre boxes."""
        return self.states[:, :, :4]


@dataclass(frozen=True)
class Simulation:
    """Settings of a simulation.

    Attributes:
        frames: T, frames after the first one.
        draws: N, number of trajectories.
        seed: of all draws.
        size: width and height of the image; None for one without borders.
        inputs: what is known of every frame; those that go by time are as of one frame a second.
    """

    frames: int = 50
    draws: int = 200
    seed: int = 0
    size: tuple[int, int] | None = None
    inputs: Mapping[str, TimedInput] = field(default_factory=dict)


def simulate(
    plate: CheckedTarget, constants: dict[str, float], box: Floats, simulation: Simulation
) -> Simulated:
    """Trajectories of a target that starts in the centre box (4,), as the tracker predicts without evidence.

    What depends on evidence is left out: `camera`, `inflate` and `relocalize`.

    Raises:
        ValueError: frames or draws are less than 1.
    """
    if simulation.frames < 1 or simulation.draws < 1:
        raise ValueError(
            f"{simulation.frames} frames and {simulation.draws} draws: at least 1 of each is needed"
        )
    motion = prior_motion(plate, constants, np.asarray(box, dtype=np.float64)[2:4])
    if simulation.size is not None:
        motion = confined(motion, *simulation.size)
    streams = Streams(simulation.seed)

    def stream(frame: int) -> np.random.Generator:
        return streams.of("", plate.root, frame, "simulate")

    states = [motion.start(np.asarray(box, dtype=np.float64), simulation.draws, stream(0))]
    for frame in range(1, simulation.frames + 1):
        numbers = values_at(simulation.inputs, (frame, frame - 1), (float(frame), frame - 1.0))
        into = framed(motion, simulation.size, {"t": float(frame), **numbers})
        states.append(into.propagate(states[-1].copy(), 1.0, stream(frame)))
    modes = modes_of(plate.inference(plate.root))
    return Simulated(np.array(states), motion.fields, () if modes is None else modes.names)


def prior_motion(plate: CheckedTarget, constants: dict[str, float], first_size: Floats) -> MotionModel:
    """The motion of a plate from one frame to the next, before anything was seen."""
    root = plate.inference(plate.root)
    assert root.motion is not None
    plain, settings = (
        make_plate_motion(root, constants, deviations_of(plate.spec.nodes)),
        root.motion.settings,
    )
    if not isinstance(settings, Moving) or settings.is_plain:
        return plain
    return compose_motion(plain, settings, Influences(1.0, first_size))
