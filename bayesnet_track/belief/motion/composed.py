"""Motions made of other motions: nested fields, more noise while unsure, and the motion of one frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, LEAST_SIDE_PX, Ancestors, MotionModel
from bayesnet_track.belief.motion.borders import Confined, Reflecting
from bayesnet_track.belief.motion.delayed import CameraShift, Delayed, ShiftedMotion
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.graph import spec
from bayesnet_track.graph.checked import CLOCK, RATE, LastingError
from bayesnet_track.graph.settings.motion import BoxSd, Moving, SizeReversion
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import ANGLE
from bayesnet_track.observation.planes import read_only


@dataclass(frozen=True, eq=False)
class SizeShift:
    """The logarithms of scale and aspect go toward their first values: m + keep (s - m).

    Attributes:
        first: (2,) m: log sqrt(w h) and log(w / h) of the first box.
        keep: (2,) share of the difference that stays.
    """

    first: Floats
    keep: Floats

    def apply(self, states: Floats) -> Floats:
        """(N, D) states with sizes drawn back."""
        shifted = states.copy()
        log_w, log_h = np.log(states[:, 2]), np.log(states[:, 3])
        scale = self.first[0] + self.keep[0] * ((log_w + log_h) / 2 - self.first[0])
        aspect = self.first[1] + self.keep[1] * (log_w - log_h - self.first[1])
        shifted[:, 2], shifted[:, 3] = np.exp(scale + aspect / 2), np.exp(scale - aspect / 2)
        return shifted

    def jacobian(self, state: Floats) -> Floats:
        """(D, D): of log w and log h a constant matrix, of w and h that times w' / w."""
        jacobian = np.eye(len(state))
        to_log = np.array([[0.5, 0.5], [1.0, -1.0]])
        from_log = np.array([[1.0, 0.5], [1.0, -0.5]])
        sizes = self.apply(state[None])[0, 2:4]
        jacobian[2:4, 2:4] = sizes[:, None] * (from_log @ np.diag(self.keep) @ to_log) / state[2:4]
        return jacobian


def revert_size(motion: KinematicMotion, settings: SizeReversion, first: Floats, dt: float) -> ShiftedMotion:
    """The motion with log size an Ornstein-Uhlenbeck process around the size (2,) `first`, over `dt`.

    With the noise's sd s per frame interval and the sd S in the long run, the rate is k = s^2 / (2 S^2), and
    over `dt` exactly: keep = exp(-k dt), variance S^2 (1 - keep^2), which is s^2 dt for a large S.
    """
    log_sd = motion.noise.sd_log
    sds, limits = (log_sd.scale, log_sd.aspect), (settings.sd_scale, settings.sd_aspect)
    keep, noise = np.ones(2), list(sds)
    for n, (sd, limit) in enumerate(zip(sds, limits, strict=True)):
        if limit is not None and sd > 0:
            keep[n] = np.exp(-(sd**2) / (2 * limit**2) * dt)
            noise[n] = float(limit * np.sqrt((1.0 - keep[n] ** 2) / dt))
    sd_log = log_sd.model_copy(update={"scale": noise[0], "aspect": noise[1]})
    reverted = replace(motion, noise=motion.noise.model_copy(update={"sd_log": sd_log}))
    log_w, log_h = np.log(first)
    return ShiftedMotion(reverted, SizeShift(np.array([(log_w + log_h) / 2, log_w - log_h]), keep))


@dataclass(frozen=True)
class Deviation:
    """One coordinate in which a latent node deviates from its place: an Ornstein-Uhlenbeck process.

    Attributes:
        name: the field of the state.
        sd: of the deviation in the long run, px, above 0.
        step_sd: of its change in one frame interval beside the pull to 0, px, above 0 and at most `sd`.
    """

    name: str
    sd: float
    step_sd: float

    def over(self, dt: float) -> tuple[float, float]:
        """Share of it that is left after `dt` frame intervals, as a factor, and the sd of what is added.

        d <- f^dt d + N(0, sd^2 (1 - f^(2 dt))) with f = sqrt(1 - step_sd^2 / sd^2): two steps of dt / 2 are
        one of dt, and N(0, sd^2) stays what it is.

        >>> [round(value, 6) for value in Deviation("head.x", 5.0, 3.0).over(1.0)]
        [0.8, 3.0]
        """
        share = (1.0 - (self.step_sd / self.sd) ** 2) ** (dt / 2.0)
        return share, self.sd * float(np.sqrt(1.0 - share**2))


@dataclass(frozen=True)
class Walk:
    """A coordinate that walks at random, with nothing that pulls it back.

    Attributes:
        name: the field of the state.
        sd: of its change in one frame interval, above 0.
    """

    name: str
    sd: float

    def over(self, dt: float) -> tuple[float, float]:
        """Share and sd as of a `Deviation`."""
        return 1.0, self.sd * float(np.sqrt(dt))


@dataclass(frozen=True)
class Lasting:
    """An error that lasts: an Ornstein-Uhlenbeck process that is in its long run from the start.

    Attributes:
        name: the field of the state.
        sd: at any time, above 0.
        time: in which its correlation falls to 1 / e, above 0; infinite of one that stays.
        is_of_camera: whether it is of a camera, so that image agents are no evidence of it.
        grows_by: the field by which it grows per unit of time; "" of one that does not.
    """

    name: str
    sd: float
    time: float
    is_of_camera: bool
    grows_by: str = ""

    def over(self, dt: float) -> tuple[float, float]:
        """Share and sd as of a `Deviation`.

        >>> [round(value, 6) for value in Lasting("view.x", 5.0, 2.0, True).over(2.0)]
        [0.367879, 4.649367]
        """
        share = math.exp(-dt / self.time)
        return share, self.sd * math.sqrt(-math.expm1(-2.0 * dt / self.time))


def lasting_of(errors: Sequence[LastingError]) -> tuple[Lasting, ...]:
    """Fields of the state for errors of what sees the targets."""
    rates = {error.node: error.field for error in errors if error.axis == RATE}
    return tuple(
        Lasting(
            error.field,
            error.sd,
            error.over_s,
            error.is_shared or error.is_by_place,
            rates.get(error.node, "") if error.axis == CLOCK else "",
        )
        for error in errors
    )


def shared_columns(motion: MotionModel) -> tuple[int, ...]:
    """Columns of the errors of cameras."""
    while isinstance(motion, Confined | Reflecting):
        motion = motion.motion
    if not isinstance(motion, Nested):
        return ()
    first = len(motion.fields) - len(motion.deviations)
    return tuple(
        first + k
        for k, deviation in enumerate(motion.deviations)
        if getattr(deviation, "is_of_camera", False)
    )


def turning(motion: MotionModel, sd_deg: float) -> Nested:
    """`motion`, with a last column of the state: by how much the target is turned since its first frame.

    In degrees, clockwise in the picture. It walks on the line, not on the circle: a target that turned once
    is at 360, so that means, variances and densities of the belief are plain ones. What looks at the target
    sees the same at 360 as at 0. `sd_deg` is that of its step in one frame interval, above 0.
    """
    return Nested(motion, (Walk(ANGLE, sd_deg),))


def field_of(node: str, axis: str) -> str:
    """The field of a state in which a node's deviation along an axis of its box stands."""
    return f"{node}.{axis}"


def deviations_of(nodes: Mapping[str, spec.Node]) -> tuple[Deviation, ...]:
    """The deviations of latent nodes that move, in file order: coordinates in which `given` has noise."""
    return tuple(
        Deviation(field_of(name, axis), sd, getattr(node.motion.settings.sd_px, axis))
        for name, node in nodes.items()
        if isinstance(node, spec.InferenceNode) and node.parent is not None and node.motion is not None
        if node.fuse is not None and node.fuse.latent is not None
        for axis in BOX_FIELDS
        if (sd := getattr(node.fuse.latent.given.sd_px, axis)) > 0
    )


@dataclass(frozen=True, eq=False)
class Nested:
    """`motion`, with last columns of the state for coordinates of their own; errors apart 0 at first.

    They move independently of the box and of each other. Of the deviations of latent nodes: the agents
    learn a part at its place in the start box, so it deviates from there by nothing yet; where a part is
    depends on its parent's box through its place alone.

    Attributes:
        motion: how the rest moves.
        deviations: the further columns.
    """

    motion: MotionModel
    deviations: tuple[Deviation | Walk | Lasting, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the model, and the deviations."""
        return (*self.motion.fields, *(deviation.name for deviation in self.deviations))

    @property
    def leaves_image(self) -> bool:
        """True where targets go on beyond the frame."""
        return bool(getattr(self.motion, "leaves_image", False))

    @property
    def least_side(self) -> float:
        """Of widths and heights, in the unit of the state."""
        return float(getattr(self.motion, "least_side", LEAST_SIDE_PX))

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model, everything in its place."""
        states, sds = self.motion.start(box, size, rng), self._first_sds
        deviations = sds * rng.standard_normal((size, len(sds))) if sds.any() else np.zeros((size, len(sds)))
        return _with(states, deviations)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Like the model, everything in its place."""
        mean, covariance = self.motion.start_moments(box)
        count = len(self.deviations)
        spread = np.pad(covariance, (0, count))
        diagonal = np.arange(len(mean), len(spread))
        spread[diagonal, diagonal] = self._first_sds**2
        return np.append(mean, np.zeros(count)), spread

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        deviations = self._deviations_of(states) if parents is None else self._deviations_of(states)[parents]
        _, sds = self._over(dt)
        propagated = self.motion.propagate(self._without_deviations(states), dt, rng, parents)
        return _with(propagated, self._carry(deviations, dt) + sds * rng.standard_normal(deviations.shape))

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise."""
        return _with(
            self.motion.drift(self._without_deviations(states), dt),
            self._carry(self._deviations_of(states), dt),
        )

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q of the model; each deviation's are what is kept of it and the variance that is added."""
        return self.moves(dt) or self._linearise(state, dt)

    def moves(self, dt: float) -> tuple[Floats, Floats] | None:
        """F and Q, read-only, of every state, where the model is linear with Gaussian noise; else None."""
        return _moves(self, dt)

    def _linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        count = len(self.deviations)
        transition, covariance = (
            np.pad(matrix, (0, count)) for matrix in self.motion.linearise(state[:-count], dt)
        )
        shares, sds = self._over(dt)
        diagonal = np.arange(len(state) - count, len(state))
        transition[diagonal, diagonal], covariance[diagonal, diagonal] = shares, sds**2
        for grown, rate in self._grown:
            transition[diagonal[grown], diagonal[rate]] = dt
        return transition, covariance

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) that of the model, times those of the deviations, per unit of each."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Transition of the model; the deviations are the last coordinates."""
        transition = self.motion.transition(self._without_deviations(previous), dt)
        count = len(self.deviations)
        _, step_sds = self._over(dt)
        sds = np.broadcast_to(step_sds, (*transition.sds.shape[:2], count))

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = transition.coordinates(self._without_deviations(states))
            return _with(points, self._deviations_of(states)), log_jacobian

        def states_at(points: Floats, still: Floats) -> Floats:
            assert transition.states is not None
            inner_points = np.ascontiguousarray(points[:, :-count])
            return _with(transition.states(inner_points, self._without_deviations(still)), points[:, -count:])

        return replace(
            transition,
            coordinates=coordinates,
            means=_with(transition.means, self._carry(self._deviations_of(previous), dt)),
            sds=np.concatenate([transition.sds, sds], axis=2),
            states=None if transition.states is None else states_at,
        )

    @property
    def _first_sds(self) -> Floats:
        return np.array(
            [deviation.sd if isinstance(deviation, Lasting) else 0.0 for deviation in self.deviations]
        )

    def _over(self, dt: float) -> tuple[Floats, Floats]:
        shares, sds = zip(*(deviation.over(dt) for deviation in self.deviations), strict=True)
        return np.array(shares), np.array(sds)

    @property
    def _grown(self) -> list[tuple[int, int]]:
        """Places of deviations that grow, each with that of the one by which."""
        places = {deviation.name: place for place, deviation in enumerate(self.deviations)}
        growing = ((deviation.name, getattr(deviation, "grows_by", "")) for deviation in self.deviations)
        return [(places[name], places[rate]) for name, rate in growing if rate]

    def _carry(self, deviations: Floats, dt: float) -> Floats:
        """(N, L) deviations after `dt` frame intervals, without noise."""
        decayed = deviations * self._over(dt)[0]
        for grown, rate in self._grown:
            decayed[:, grown] += dt * deviations[:, rate]
        return decayed

    def _without_deviations(self, states: Floats) -> Floats:
        return np.ascontiguousarray(states[:, : -len(self.deviations)])

    def _deviations_of(self, states: Floats) -> Floats:
        return states[:, -len(self.deviations) :]


@lru_cache(maxsize=256)
def _moves(nested: Nested, dt: float) -> tuple[Floats, Floats] | None:
    try:
        if isinstance(nested.motion, KinematicMotion) and linear_gaussian(nested.motion, dt):
            transition, noise = nested._linearise(np.ones(len(nested.fields)), dt)
            return read_only(transition), read_only(noise)
    except ValueError:  # its noise depends on the state
        pass
    return None


def _with(states: Floats, columns: Floats) -> Floats:
    return np.concatenate([states, columns], axis=1)


def inflation_factor(doubt: float, largest: float) -> float:
    """The factor sqrt(doubt), at least 1 and at most `largest`; `doubt` is UD as a multiple of its level."""
    return float(min(max(doubt, 1.0) ** 0.5, largest))


def inflate_noise(motion: KinematicMotion, factor: float) -> KinematicMotion:
    """The motion with the sds of its position, and of the noise that drives it, times `factor`.

    The size keeps its noise. The result is a motion of the same kind: its density is that of what it draws.
    """
    if factor == 1.0:
        return motion
    px, box = motion.noise.sd_px, motion.noise.sd_box
    wider = {
        "sd_px": px.model_copy(update={"x": factor * px.x, "y": factor * px.y}),
        "sd_box": BoxSd(x=factor * box.x, y=factor * box.y),
    }
    noise = motion.noise.model_copy(update=wider)
    return replace(motion, noise=noise, diffusion=factor**2 * motion.diffusion)


@dataclass(frozen=True, eq=False)
class Influences:
    """Influences on the motion into a frame; with the graph, the motion itself.

    Attributes:
        dt: frame intervals since the last frame.
        first_size: (2,) width and height of the first box, px, to which the size reverts.
        inflation: factor on the noise's sds while the belief is unsure.
        camera: how the camera moved the picture; None where it rested or is not followed.
        jump_share: probability that the target is anywhere instead.
    """

    dt: float
    first_size: Floats
    inflation: float = 1.0
    camera: CameraShift | None = None
    jump_share: float = 0.0


def compose_motion(plain: MotionModel, settings: Moving, influences: Influences) -> MotionModel:
    """The plate's motion under what influenced it, but for jumps: `plain` where nothing can.

    In this order: the camera moves the states, their sizes are drawn back, noise is added, widened while
    unsure, and what left the frame is reflected. Where it moves in modes, so does each of them.
    """
    if isinstance(plain, Modal):
        return plain.each(lambda part: compose_motion(part, settings, influences))
    kinematics = kinematics_of(plain)
    if kinematics is None:
        return plain
    kinematics = inflate_noise(kinematics, influences.inflation)
    motion: MotionModel = kinematics
    if settings.size_reversion is not None:
        motion = revert_size(kinematics, settings.size_reversion, influences.first_size, influences.dt)
    if influences.camera is not None:
        motion = ShiftedMotion(motion, influences.camera)
    return _put_inside(plain, motion)


def kinematics_of(plain: MotionModel) -> KinematicMotion | None:
    """The kinematics inside a plate's motion; None of a motion of another kind."""
    while isinstance(plain, Delayed | Nested | Reflecting):
        plain = plain.motion
    return plain if isinstance(plain, KinematicMotion) else None


def _put_inside(plain: MotionModel, motion: MotionModel) -> MotionModel:
    """The plate's motion with another one in place of its kinematics."""
    if isinstance(plain, Delayed | Nested | Reflecting):
        return replace(plain, motion=_put_inside(plain.motion, motion))
    return motion
