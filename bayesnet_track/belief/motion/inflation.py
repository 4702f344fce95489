"""More noise while the belief is unsure: a factor on the sd of the position, and of what drives it."""

from __future__ import annotations

from dataclasses import replace

from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.graph.settings.motion import BoxSd


def inflation_factor(doubt: float, most: float) -> float:
    """The factor sqrt(doubt), at least 1 and at most `most`; `doubt` is UD as a multiple of its level."""
    return float(min(max(doubt, 1.0) ** 0.5, most))


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
