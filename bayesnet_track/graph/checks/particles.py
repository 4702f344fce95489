"""Checks of the particle belief's settings: bounds, errors and resampling that make sense together."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.settings.particles import AdaptiveSize, EssBelow, NormalSize, Particles
from bayesnet_track.graph.text.messages import GraphMessage


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
