"""What the motion of one frame depends on besides the states, and the motion that it makes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.borders import Reflecting
from bayesnet_track.belief.motion.inflation import inflate_noise
from bayesnet_track.belief.motion.modal import Modal
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.motion.nested import Nested
from bayesnet_track.belief.motion.shifted import CameraShift, ShiftedMotion, revert_size
from bayesnet_track.graph.settings.motion import Moving
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Influences:
    """What the motion into a frame depended on; with the graph, the motion itself.

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
        return plain.each(lambda one: compose_motion(one, settings, influences))
    own = kinematics_of(plain)
    if own is None:
        return plain
    own = inflate_noise(own, influences.inflation)
    motion: MotionModel = own
    if settings.size_reversion is not None:
        motion = revert_size(own, settings.size_reversion, influences.first_size, influences.dt)
    if influences.camera is not None:
        motion = ShiftedMotion(motion, influences.camera)
    return _put_inside(plain, motion)


def kinematics_of(plain: MotionModel) -> KinematicMotion | None:
    """The kinematics inside a plate's motion; None of a motion of another kind."""
    while isinstance(plain, Nested | Reflecting):
        plain = plain.motion
    return plain if isinstance(plain, KinematicMotion) else None


def _put_inside(plain: MotionModel, motion: MotionModel) -> MotionModel:
    """The plate's motion with another one in place of its kinematics."""
    if isinstance(plain, Nested | Reflecting):
        return replace(plain, motion=_put_inside(plain.motion, motion))
    return motion
