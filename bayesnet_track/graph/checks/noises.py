"""Checks of errors of measurements that are written as expressions: they exist, and the belief takes them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bayesnet_track.graph.checks.cues import noises_of
from bayesnet_track.graph.checks.factors import explain_name, latent_above, names_of_measures
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import DRAWN, ExpressionError, names_in
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath


def noises_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """The sd of an error, or its distribution, is an expression of the state and exists."""
    for name, node in plate.agents.items():
        for quantity, text in noises_of(plate, node).items():
            key: KeyPath = ("agent", node.agent.cue, "sd", quantity)
            try:
                term = parse(text, names_of_measures(plate, node), error=True)
            except ExpressionError as error:
                message = plate.message(name, error.found, error.allowed, key=key)
                yield plate.at.inside(explain_name(message, error.word, error.near), error.at)
                continue
            fixed = {one: plate.constants[one] for one in names_in(term) if one in plate.constants}
            read = [one for one in names_in(term) if one not in fixed and one not in (DRAWN, "pi")]
            if not read and not math.isfinite(float(log_values(term, {**fixed, DRAWN: np.zeros(1)})[0])):
                allowed = "an sd, a scale and degrees above 0"
                yield plate.message(name, f"{quantity} is {text!r}", allowed, key=key)


def noises_fit_the_belief(plate: Plate) -> Iterator[GraphMessage]:
    """A Gaussian learns nothing of a field that only noise reads, and `kalman` takes no such noise."""
    root = plate.inference[plate.roots[0]]
    for name, node in plate.agents.items():
        noises = noises_of(plate, node)
        if not noises or root.belief is None or root.belief.particles is not None:
            continue
        key: KeyPath = ("agent", node.agent.cue, "sd")
        if root.belief.gaussian is not None and root.belief.gaussian.filter == "kalman":
            found = "an sd by an expression beside filter: kalman, which is of Gaussian noise that is known"
            yield plate.message(name, found, "filter: extended or unscented", key=key, on_key=True)
        if latent_above(plate, node.parent) is not None and root.belief.gaussian is not None:
            found = "an sd by an expression below a latent node, and belief: gaussian"
            yield plate.message(name, found, "belief: particles, or a number", key=key, on_key=True)
        for quantity, text in noises.items():
            unread = [one for one in _read_by(text) if root.belief.gaussian and _is_noise_alone(plate, one)]
            if unread:
                found = f"belief: gaussian learns nothing of {unread[0]}, which only noise reads"
                yield plate.message(name, found, "belief: particles", key=(*key, quantity))


def _read_by(text: str) -> list[str]:
    try:
        return names_in(parse(text, error=True))
    except ExpressionError:
        return []


def _is_noise_alone(plate: Plate, field: str) -> bool:
    """True of a field of the root's own that no drift of another one and no measurement reads."""
    root = plate.inference[plate.roots[0]]
    motions = [root.motion, *(mode.motion for mode in (root.modes or {}).values())]
    texts = [text for node in plate.agents.values() for text in node.measures.values()]
    owned = False
    for motion in motions:
        if motion is not None and motion.expressions is not None:
            owned = owned or field in motion.expressions.own
            texts += [str(text) for name, text in motion.expressions.drift.items() if name != field]
    texts += [one.expression for one in plate.factors.values()]
    given = [
        quantity
        for node in plate.agents.values()
        if (cue := plate.cues.get(node.agent.cue)) is not None and cue.gives is not None
        for quantity in noises_of(plate, node)
    ]
    return owned and field not in given and not any(field in _read_by(text) for text in texts)


NOISE_CHECKS: tuple[Check, ...] = (noises_can_be_read, noises_fit_the_belief)
