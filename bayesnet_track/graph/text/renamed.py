"""Words of the language that have been renamed, each with the word that took its place."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesnet_track.graph.settings.base import Model

RENAMED: Mapping[str, str] = MappingProxyType(
    {
        "Target.recall": "reidentify",
        "Target.duplicates": "merge_duplicates",
        "Birth.most": "max_targets",
        "Birth.apart_box": "min_distance_box",
        "Birth.covered": "max_overlap",
        "Confirm.looks": "hits",
        "Reidentify.least_probability": "min_probability",
        "InferenceNode.slack": "localization_error",
        "InferenceNode.rivals": "distractors",
        "Particles.importance": "proposal",
        "Proposal.regular": "bootstrap",
        "Proposal.adaptive": "second_pass",
        "Proposal.rejection": "prior_editing",
        "Proposal.west": "iterated",
        "Estimate.best": "max_weight",
        "Noise.wide": "heavy_tail",
        "HeavyTail.share": "weight",
        "Moving.widen": "inflate",
        "Moving.keep_size": "size_reversion",
        "Moving.recover": "relocalize",
        "Inflate.most": "max_factor",
        "Probes.most": "max_boxes",
        "Level.ud_quiet": "ud_baseline",
        "Deactivate.glance": "sample_every",
        "Deactivate.drop.dearest": "most_expensive",
        "Deactivate.drop.dearest_dispensable": "most_expensive_redundant",
        "Deactivate.drop.least_contribution_per_ms": "min_contribution_per_ms",
        "Deactivate.drop.least_information_per_ms": "min_information_per_ms",
        "Information.memory": "memory_frames",
        "Information.explore": "exploration",
        "Logistic.memory": "memory_frames",
        "detection.least_overlap": "min_overlap",
        "detection.looks": "appearance",
        "displacement.least_seen": "min_seen",
        "klt.least_correlation": "min_correlation",
        "klt.least_seen": "min_seen",
        "klt.most_scale": "max_scale",
        "opencv_tracker.least_correlation": "min_correlation",
    }
)
"""Old word -> new word: a key of settings or of a cue's parameters, or a value of such a key."""


def new_word(owner: type | str, word: str) -> str | None:
    """The new name of a key of some settings (their class) or of a cue's parameters (its name), else None.

    `word` is a key, or a key and its value joined by a dot.

    >>> from bayesnet_track.graph.settings.adapt import Deactivate
    >>> new_word(Deactivate, "glance"), new_word(Deactivate, "drop.dearest"), new_word("klt", "floor")
    ('sample_every', 'most_expensive', None)
    """
    if isinstance(owner, str):
        return RENAMED.get(f"{owner}.{word}")
    kinds = (kind for kind in owner.__mro__ if issubclass(kind, Model))
    return next((new for kind in kinds if (new := RENAMED.get(f"{kind.__name__}.{word}"))), None)
