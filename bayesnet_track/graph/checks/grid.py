"""The checks of the grid belief: which motions its cells can hold, and at which level it is reset."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.text.messages import GraphMessage


def grid_holds_the_motion(plate: Plate) -> Iterator[GraphMessage]:
    """Cells cover position, velocity and scale: no acceleration, no change of aspect, no size noise in px."""
    for name, node in plate.inference.items():
        if node.belief is None or node.belief.grid is None or node.motion is None:
            continue
        if node.motion.expressions is not None:
            continue
        kind, settings = node.motion.kind, node.motion.settings
        if kind == "constant_acceleration":
            found = "a grid has no cells for accelerations"
            allowed = "random_walk, constant_velocity, damped_velocity"
            yield plate.message(name, found, allowed, key=("motion", kind), on_key=True)
        sized = [f"sd_px.{side}" for side in ("w", "h") if getattr(settings.sd_px, side) > 0]
        if settings.sd_log.aspect > 0:
            sized.append("sd_log.aspect")
        if sized:
            found = f"a grid has no cells for {', '.join(sized)}"
            allowed = "size noise by sd_log.scale alone, or none"
            yield plate.message(name, found, allowed, key=("motion", kind))


def grid_resets_at_one_level(plate: Plate) -> Iterator[GraphMessage]:
    """`reset` has a threshold of gamma or a rate of false resets, not both."""
    for name, node in plate.inference.items():
        reset = node.belief.grid.reset if node.belief is not None and node.belief.grid is not None else None
        if reset is not None and reset.below is not None and reset.false_rate is not None:
            found, allowed = "reset with both below and false_rate", "one of below, false_rate"
            yield plate.message(name, found, allowed, key=("belief", "grid", "reset"))
