"""`fit --fusion`: how much the errors of a pool's children have in common, written into a graph's text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import complain, users_mistake
from bayesnet_track.cli.fitting.videos import Video, frames_of
from bayesnet_track.journal.text.wording import plural

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph


def fit_fusion(text: str, graph: CheckedGraph, videos: Sequence[Video], end: int | None) -> str:
    """The graph's text with the `correlation` of every learned pool."""
    from bayesnet_track.evaluate.cue_parameters import fit_correlation, learned_pools, pool_errors
    from bayesnet_track.graph.settings.net import pool_exponents
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    with users_mistake():
        pools = learned_pools(plate)
    found = []
    for video in videos:
        with frames_of(video, end) as frames, users_mistake():
            found.append(pool_errors(graph, frames, video.truth))
    for pool, children in pools.items():
        with users_mistake():
            fitted = fit_correlation([one[pool] for one in found])
        value = float(f"{fitted.value:.3g}")
        exponent = next(iter(pool_exponents(dict.fromkeys(children, 1.0), value).values()))
        low, high = fitted.without
        complain(
            f"{pool}: errors correlated by {value:g} ({low:.2f} to {high:.2f} without one video), from "
            f"{plural(fitted.frames, 'frame')}; each of {len(children)} children counts {exponent:.2f}"
        )
        comment = f"errors at true boxes, {fitted.frames} frames of {plural(len(videos), 'video')}"
        text = set_value(text, ("targets", name, "nodes", pool, "correlation"), value, comment)
    return text
