"""Settings of noise and motion, reappearance, and modes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.adapt import Level
from bayesnet_track.graph.settings.base import (
    Choice,
    Empty,
    Model,
    Name,
    NotNegative,
    Number,
    Positive,
    Truth,
    Whole,
)
from bayesnet_track.graph.settings.cameras import MetreSd
from bayesnet_track.graph.settings.lifecycle import DetectorChoice


class Probes(Model):
    """Boxes of the belief's size on a lattice over the frame, scored by the active agents of the net."""

    max_boxes: Annotated[Whole, Field(ge=16, le=10_000)] = Field(default=400, description="boxes at most")


class LookedFor(Choice):
    """Choice of the places to search; weights correct for the choice, so it changes no probability."""

    uniform: Empty | None = Field(default=None, description="evenly over the frame")
    agents: Probes | None = Field(
        default=None,
        description="by the net's own agents, at boxes on a lattice",
    )
    detector: DetectorChoice | None = Field(
        default=None, description="by the boxes of a detector; one that learns is given the first box"
    )


class Sudden(Model):
    """A fast move is found in the same frame: where suddenly nothing fits, a square around it is searched.

    The frame is then filtered again with a wider prior, before the target is lost. Needs
    `lost: {found_fit}`, by which it is known how well the target usually fits.
    """

    below_fit: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.15,
        description="share of the usual fit below which it searches; what it finds has to reach it, and the "
        "`full_fit` of the score",
    )
    reach_box: Annotated[Number, Field(gt=0, le=10)] = Field(
        default=2.5, description="half the side of the square, in sqrt(w h)"
    )
    pan_box: NotNegative = Field(
        default=0.0,
        description="only where the whole picture moved at least so far since the last frame, sqrt(w h): a "
        "fast camera makes targets fast, and what is merely covered is not searched for; 0: always",
    )
    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.5,
        description="probability, in such a frame, that it is anywhere in the square; and the share of the "
        "hypotheses that look there",
    )


class Relocalize(Model):
    """The target may reappear anywhere: p(x | x') = (1 - share) motion + share / (W H) in its position.

    It is then found again after an occlusion, or after leaving the view. Needs particles of a fixed `size`
    with `proposal: bootstrap`. Beside a Gaussian, agents that say how sure they are look for a target
    that is lost, or uncertain for as long as it takes to be called lost, and `share` weighs what they say of
    other places against what they say of its own.
    """

    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1,
        description="probability per frame interval that it reappears elsewhere, while uncertain or lost",
    )
    above: Level = Field(
        default=Level(ud_box=0.5), description="threshold of UD above which the belief is uncertain"
    )
    usual: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="the same probability while it is certain"
    )
    hypotheses: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.2, description="share of the hypotheses that look for it, in proportion to the probability"
    )
    by: LookedFor = Field(default=LookedFor(agents=Probes()), description="where they look")
    grow_box: Positive | None = Field(
        default=None,
        description="only while lost (beside a Gaussian, or as long uncertain), and at first near the place "
        "where it was last held: in a square around it, half of whose side grows by so many sqrt(w h) per "
        "frame interval until it covers the frame; default: in the whole frame at once",
    )
    sudden: Sudden | None = Field(
        default=None, description="how a fast move is found before the target is lost; default: not at all"
    )


class PixelSd(Model):
    """Standard deviations in pixels, for a step of one frame interval."""

    x: NotNegative = Field(default=0.0, description="of the centre's column, px")
    y: NotNegative = Field(default=0.0, description="of the centre's row, px")
    w: NotNegative = Field(default=0.0, description="of the width, px")
    h: NotNegative = Field(default=0.0, description="of the height, px")


class BoxSd(Model):
    """Standard deviations as a share of the box's mean side sqrt(w h)."""

    x: NotNegative = Field(default=0.0, description="of the centre's column, sqrt(w h)")
    y: NotNegative = Field(default=0.0, description="of the centre's row, sqrt(w h)")


class LogSd(Model):
    """Standard deviations of the size in logarithms, so that they carry over between sizes."""

    scale: NotNegative = Field(default=0.0, description="of log sqrt(w h)")
    aspect: NotNegative = Field(default=0.0, description="of log(w / h)")


class HeavyTail(Model):
    """A share of the noise of the position has a larger sd: heavy tails, as of sudden motion."""

    weight: Annotated[Number, Field(gt=0, lt=1)] = Field(description="share of the noise")
    factor: Annotated[Number, Field(gt=1)] = Field(description="factor on the sd of the position")


class Noise(Model):
    """Gaussian noise of a box; pixel and relative parts add up in variance.

    Variances grow in proportion to the true time between frames.
    """

    sd_px: PixelSd = Field(default=PixelSd(), description="in pixels")
    sd_box: BoxSd = Field(default=BoxSd(), description="relative to the box")
    sd_log: LogSd = Field(default=LogSd(), description="of the size, in logarithms")
    heavy_tail: HeavyTail | None = Field(default=None, description="heavy tails of the position")


class Inflate(Model):
    """The position's noise is inflated while the belief is uncertain.

    Its sd is multiplied by sqrt(UD / threshold), with the UD of the last frame: by 1 up to the threshold, and
    by `max_factor` at most. The search widens as fast as the belief, and narrows with it.
    """

    above: Level = Field(
        default=Level(ud_box=0.12), description="threshold of UD up to which nothing changes"
    )
    max_factor: Annotated[Number, Field(gt=1)] = Field(default=4.0, description="largest factor on the sd")


class SizeReversion(Model):
    """The size reverts to that of the first box, so that it cannot collapse when a cue prefers small boxes.

    The logarithms of scale and aspect are Ornstein-Uhlenbeck processes around their first values, exactly
    discretised: noise as `sd_log` says, and in the long run no more than the sd given here.
    """

    sd_scale: Positive | None = Field(
        default=None, description="sd of log sqrt(w h) in the long run; default none, a random walk"
    )
    sd_aspect: Positive | None = Field(
        default=None, description="sd of log(w / h) in the long run; default none, a random walk"
    )


class Moving(Noise):
    """A motion of the target: its noise, and what else is known of it."""

    inflate: Inflate | None = Field(default=None, description="more noise while uncertain; default: never")
    size_reversion: SizeReversion | None = Field(
        default=None, description="pulls the size back to the first one; default: no"
    )
    sd_angle_deg: NotNegative = Field(
        default=0.0,
        description="of the target's rotation in the image plane, degrees; 0: the state has no angle",
    )
    camera: Literal["compensate"] | None = Field(
        default=None, description="first move hypotheses with the flow of the background; default: no"
    )
    relocalize: Relocalize | None = Field(
        default=None, description="the target may reappear anywhere; default: never"
    )
    borders: Literal["reflect"] | None = Field(
        default=None,
        description="the box bounces off the borders of the frame, and its velocity is reversed; default: its"
        " centre stops there",
    )

    start_sd_px: PixelSd = Field(
        default=PixelSd(), description="error of the first box; `start` of the root says other distributions"
    )

    @property
    def start_texts(self) -> dict[str, str]:
        """Field of the box -> its distribution when the target starts, as an expression."""
        sds = {name: getattr(self.start_sd_px, name) for name in ("x", "y", "w", "h")}
        return {name: f"normal({name}, {sd!r})" for name, sd in sds.items() if sd > 0}

    @property
    def is_plain(self) -> bool:
        """True if it is noise and kinematics alone."""
        return (
            self.inflate is None
            and self.size_reversion is None
            and self.camera is None
            and self.relocalize is None
        )


class OnGround(Moving):
    """A motion that may be in metres."""

    sd: MetreSd | None = Field(
        default=None, description="of a state [on the ground](metres.md), instead of `sd_px`; default none"
    )


class RandomWalk(OnGround):
    """Position and size drift by independent noise."""


class ConstantVelocity(OnGround):
    """White noise in acceleration: `sd_velocity_px` is the change of velocity in one frame interval.

    `sd_px`, `sd_box`, `sd_log` are added to position and size as in a random walk.
    """

    sd_velocity_px: NotNegative = Field(default=1.0, description="px per frame, per frame interval")
    start_velocity_sd_px: NotNegative = Field(
        default=5.0, description="sd of the unknown first velocity, px per frame"
    )
    sd_velocity: NotNegative | None = Field(
        default=None,
        description="of a state on the ground: m/s in one second, instead of `sd_velocity_px`; default 1",
    )
    start_velocity_sd: NotNegative | None = Field(
        default=None,
        description="of a state on the ground: m/s, instead of `start_velocity_sd_px`; default 5",
    )


class DampedVelocity(ConstantVelocity):
    """Constant velocity that decays by `damping` per frame interval.

    Damped velocity of the tracking chapter, eq. 3.91 corrected.
    """

    damping: Annotated[Number, Field(gt=0)] = Field(
        default=0.25, description="velocity decays as exp(-damping dt)"
    )


class ConstantAcceleration(OnGround):
    """White noise in the derivative of acceleration."""

    sd_acceleration_px: NotNegative = Field(default=0.5, description="px per frame^2, per frame interval")
    start_velocity_sd_px: NotNegative = Field(
        default=5.0, description="sd of the unknown first velocity, px per frame"
    )
    start_acceleration_sd_px: NotNegative = Field(
        default=1.0, description="sd of the unknown first acceleration, px per frame^2"
    )
    sd_acceleration: NotNegative | None = Field(
        default=None,
        description="of a state on the ground: m/s^2 in one second, instead of `sd_acceleration_px`; "
        "default 0.5",
    )
    start_velocity_sd: NotNegative | None = Field(
        default=None,
        description="of a state on the ground: m/s, instead of `start_velocity_sd_px`; default 5",
    )
    start_acceleration_sd: NotNegative | None = Field(
        default=None,
        description="of a state on the ground: m/s^2, instead of `start_acceleration_sd_px`; default 1",
    )


Expression = Annotated[
    Annotated[Number, Tag("number")] | Annotated[str, Field(max_length=MAX_CHARACTERS), Tag("text")],
    Discriminator(lambda value: "text" if isinstance(value, str) else "number"),
]
"""A number, or an expression as text."""


class OwnField(Model):
    """A field of the state beside the box, such as a speed or a heading."""

    start: Number = Field(
        default=0.0, description="its mean when the target starts; of x, y, w, h always the start box"
    )
    sd: NotNegative = Field(default=0.0, description="its sd when the target starts")


class ByExpressions(Model):
    """A motion of one's own, by [expressions](expressions.md#motion): x' = drift + noise, field by field.

    Example::

        expressions:
          fields: {vx: {sd: 5}, vy: {sd: 5}}
          drift: {x: x + vx * dt, y: y + vy * dt, vy: vy + gravity * dt}
          sd: {x: 1, y: 1, vx: 0.5, vy: 0.5}
    """

    fields: dict[Name, OwnField] = Field(
        default={},
        max_length=12,
        description="fields of the state beside x, y, w, h, at most 8; of x, y, w, h an sd at the start",
    )
    drift: dict[Name, Expression] = Field(
        default={}, description="field: its value after `dt`; a field that is not named stays"
    )
    sd: dict[Name, Expression] = Field(
        min_length=1,
        description="field: sd of its noise for one frame interval, whose variance grows with `dt`; a field "
        "that is not named has no noise",
    )
    borders: Literal["reflect"] | None = Field(
        default=None, description="as of the other motions; turns `vx, vy, ax, ay`"
    )
    static_discount: Annotated[Number, Field(ge=0.9, lt=1)] | None = Field(
        default=None,
        description="of fields that neither drift nor have noise, beside particles: their hypotheses are "
        "spread anew before each frame, by kernels of this discount (Liu and West 2001); .98 is usual",
    )

    @property
    def own(self) -> dict[str, OwnField]:
        """The fields beside x, y, w, h."""
        return {name: field for name, field in self.fields.items() if name not in ("x", "y", "w", "h")}

    @property
    def start_texts(self) -> dict[str, str]:
        """Field of the box -> its distribution when the target starts, as an expression."""
        sds = {name: self.fields[name].sd for name in ("x", "y", "w", "h") if name in self.fields}
        return {name: f"normal({name}, {sd!r})" for name, sd in sds.items() if sd > 0}

    @property
    def is_plain(self) -> bool:
        """It depends on nothing but the state, the time and the size of the frame."""
        return True

    @property
    def sd_angle_deg(self) -> float:
        """An angle is a field like others here."""
        return 0.0


class BoxVelocity(Moving):
    """Centre and sides each have a velocity; all noise is independent and Gaussian, in px.

    The state of eight fields that SORT and its successors filter: constant velocity of the whole box. Its
    noise is a diagonal matrix per frame interval, as theirs is: unlike that of `constant_velocity`, two half
    intervals are not quite one whole. It takes `sd_px` and the keys of its own, beside a belief that is
    `gaussian`.
    """

    sd_velocity_px: PixelSd = Field(default=PixelSd(), description="noise of the velocities, px per frame")
    start_velocity_sd_px: PixelSd = Field(
        default=PixelSd(x=5.0, y=5.0), description="of the unknown first velocities, px per frame"
    )
    leave_image: Truth = Field(
        default=False, description="whether centres may leave the image; else they stop at its border"
    )


class Motion(Choice):
    """Motion of the target between frames."""

    random_walk: RandomWalk | None = Field(default=None, description="position and size drift")
    constant_velocity: ConstantVelocity | None = Field(default=None, description="the velocity drifts")
    damped_velocity: DampedVelocity | None = Field(default=None, description="the velocity drifts and decays")
    constant_acceleration: ConstantAcceleration | None = Field(
        default=None, description="the acceleration drifts"
    )
    expressions: ByExpressions | None = Field(default=None, description="as expressions say")
    box_velocity: BoxVelocity | None = Field(
        default=None, description="the velocities of the centre and of both sides drift"
    )


MOST_MODES = 8
"""Each mode has hypotheses, or a Gaussian, of its own."""


class Hidden(Model):
    """The target cannot be seen in this mode: what agents say is of the background.

    An agent that gives likelihoods gives every place the same one, `likelihood`. An agent that measures sees
    nothing, or with probability `mistaken` something else, anywhere in the frame. So nothing is learnt of
    where the target is, and references stay as they are.
    """

    likelihood: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05,
        description="what an agent says of a place without the target, as a share of a perfect match; its "
        "temperature and its weight in pools hold for it, too",
    )
    mistaken: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1, description="probability that an agent that measures takes something else for the target"
    )
    missed: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1, description="probability that an agent that measures misses the target in other modes"
    )
    lost_above: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.5, description="probability of being hidden above which the target counts as lost"
    )


Row = Annotated[dict[Name, Positive], Field(min_length=1)]


class Mode(Model):
    """One of the discrete states: how the target moves in it, how long it lasts, and what follows.

    Either `mean_frames` with `then`, a chain in continuous time, or `next`, a row of the transition matrix of
    one frame interval; the same for all modes of a node.
    """

    motion: Motion | None = Field(default=None, description="how it moves; default: as the node's `motion`")
    mean_frames: Annotated[Number, Field(ge=1)] | None = Field(
        default=None, description="mean duration, in frame intervals"
    )
    then: Row | None = Field(
        default=None, description="shares of the modes that follow; default: all others equally"
    )
    next: Row | None = Field(
        default=None, description="probabilities of all modes one frame interval later; they sum to 1"
    )
    hidden: Hidden | None = Field(
        default=None, description="the target cannot be seen in it; default: it can"
    )


Modes = Annotated[dict[Name, Mode], Field(min_length=1, max_length=MOST_MODES)]
