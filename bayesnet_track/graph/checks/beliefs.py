"""Checks of the beliefs' settings: motions they can hold, bounds that agree, places of agents."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.beliefs import AdaptiveSize, EssBelow, NormalSize, Particles
from bayesnet_track.graph.settings.motion import Motion, Noise
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath


def kalman_moves_linearly(plate: Plate) -> Iterator[GraphMessage]:
    """The `kalman` filter is exact, so it takes no noise but that in px; the others approximate the rest."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or gaussian.filter != "kalman" or node.motion is None:
            continue
        if node.motion.expressions is not None:
            continue
        moved: dict[KeyPath, Motion] = {("belief", "gaussian", "filter"): node.motion}
        for mode, one in (node.modes or {}).items():
            if one.motion is not None and one.motion.expressions is None:
                moved["modes", mode, "motion"] = one.motion
        for key, motion in moved.items():
            yield from _linear(plate, name, key, motion.settings)


def _linear(plate: Plate, name: str, key: KeyPath, noise: Noise) -> Iterator[GraphMessage]:
    further = [
        f"{part}.{field}"
        for part in ("sd_box", "sd_log")
        for field in type(getattr(noise, part)).model_fields
        if getattr(getattr(noise, part), field) > 0
    ]
    further += ["heavy_tail"] if noise.heavy_tail is not None else []
    if further:
        found = f"filter: kalman with {', '.join(further)}, which is not Gaussian noise in px"
        allowed = "filter: extended or unscented, or noise by sd_px alone"
        yield plate.message(name, found, allowed, key=key)


def gaussian_settings_have_effect(plate: Plate) -> Iterator[GraphMessage]:
    """`samples` and `sigma` stand only where they are used."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or node.parent is not None:
            continue
        unused = {
            "samples": ("likelihood", "samples"),
            "sigma": ("filter", "unscented"),
        }
        for key, (setting, needed) in unused.items():
            own = getattr(gaussian, setting)
            if key in gaussian.model_fields_set and own != needed:
                found = f"{key} has no effect beside {setting}: {own}"
                allowed = f"{setting}: {needed}, or no {key}"
                yield plate.message(name, found, allowed, key=("belief", "gaussian", key), on_key=True)


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


def sizes_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """An adaptive size has its bounds in order, one error, and new parents at every frame; a fixed one has no
    bounds, and every setting an effect.
    """
    for name, node in plate.inference.items():
        particles = None if node.belief is None else node.belief.particles
        if particles is None:
            continue
        if isinstance(particles.size, AdaptiveSize):
            yield from _adaptive(plate, name, particles, particles.size)
        else:
            for key in ("min", "max"):
                if getattr(particles, key) is not None:
                    found = f"{key} beside a size of {particles.size}, which is fixed"
                    allowed = f"an adaptive size ({', '.join(AdaptiveSize.model_fields)}), or no {key}"
                    yield plate.message(name, found, allowed, key=(*_KEY, key), on_key=True)
            if isinstance(particles.when, EssBelow) and particles.proposal.kind in _REDRAWN:
                found = f"when: ess_below beside proposal: {particles.proposal.kind}, which draws new parents"
                yield plate.message(name, found, "when: every_frame", key=(*_KEY, "when"))
        adaptive = particles.proposal.second_pass
        if adaptive is not None and adaptive.by == "fitted" and "neighbours" in adaptive.model_fields_set:
            key_of_pass = (*_KEY, "proposal", "second_pass", "neighbours")
            found = "neighbours has no effect beside by: fitted"
            yield plate.message(name, found, "by: parents, or no neighbours", key=key_of_pass, on_key=True)


def _adaptive(plate: Plate, name: str, particles: Particles, size: AdaptiveSize) -> Iterator[GraphMessage]:
    if particles.least > particles.most:
        low = f"min is {particles.least}{'' if particles.min is not None else ' by default'}"
        high = f"max, {particles.most}{'' if particles.max is not None else ' by default'}"
        key = "max" if particles.min is None else "min"
        allowed = f"at least {particles.least}" if key == "max" else f"at most {particles.most}"
        yield plate.message(name, f"{low}, above {high}", allowed, key=(*_KEY, key))
    if isinstance(particles.when, EssBelow):
        found = "when: ess_below beside an adaptive size, which changes by drawing new parents"
        yield plate.message(name, found, "when: every_frame", key=(*_KEY, "when"))
    if particles.proposal.kind in _REDRAWN:
        found = f"proposal: {particles.proposal.kind} beside an adaptive size"
        allowed = "bootstrap, second_pass, iterated or prior_editing; or a size that is a number"
        yield plate.message(name, found, allowed, key=(*_KEY, "proposal"))
    if isinstance(size.settings, NormalSize):
        given = [key for key in ("error_px", "error_sd") if getattr(size.settings, key) is not None]
        if len(given) != 1:
            found = "asymptotic_normal with both error_px and error_sd" if given else "no error to keep"
            key_of_size = (*_KEY, "size", "asymptotic_normal")
            yield plate.message(name, found, "exactly one of error_px, error_sd", key=key_of_size)


_KEY = ("belief", "particles")
_REDRAWN = ("auxiliary", "likelihood_mixture")
"""Importance functions that draw a fixed number of new parents at every frame."""


def what_cannot_be_sent_stays(plate: Plate) -> Iterator[GraphMessage]:
    """A cue whose state cannot be stored cannot be sent to a worker process, either."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if node.on == "process" and declaration is not None and declaration.opaque:
            found = f"{node.agent.cue} keeps what cannot be sent to another process"
            yield plate.message(name, found, "on: engine, or no such key", key=("on",))


PLACE_CHECKS: tuple[Check, ...] = (what_cannot_be_sent_stays,)
