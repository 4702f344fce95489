"""What else a recipe remembers of a run, by name."""

from __future__ import annotations

from collections.abc import Collection

from bayesnet_track.engine.step import Engine
from bayesnet_track.observation import plugins

KEEPS_BELIEFS = "keep_beliefs"
"""The option by which a recipe says that beliefs are kept for smoothing."""

ALL_HYPOTHESES = "all_hypotheses"
"""The option by which a recipe says that hypotheses are written however many targets a frame has."""

HORIZON = "horizon"
"""The option by which a recipe says how many frames ahead targets are forecast."""

MAX_SIDE = "max_side"
"""The option by which a recipe says what the longest side of the frames is that are tracked in."""

VIDEO_FORMAT = "video"
"""The option by which a recipe says that the annotated video is `mp4`; without it, it is Matroska."""


def options_of(
    engine: Engine,
    budget_ms: float | None,
    written: Collection[str],
    horizon: int = 0,
    max_side: int | None = None,
) -> dict[str, bool | int | float | str]:
    """What else the recipe remembers: the budget, and what of other packages is at work.

    `written` is what the run writes besides what every run has: `beliefs`, `hypotheses`, `mp4`.
    """
    options: dict[str, bool | int | float | str] = {}
    if budget_ms is not None:
        options["budget_ms"] = budget_ms
    if "beliefs" in written:
        options[KEEPS_BELIEFS] = True
    if "hypotheses" in written:
        options[ALL_HYPOTHESES] = True
    if horizon:
        options[HORIZON] = horizon
    if max_side is not None:
        options[MAX_SIDE] = max_side
    if "mp4" in written:
        options[VIDEO_FORMAT] = "mp4"
    named: set[str] = set()
    for compiled in engine.plates.values():
        named |= {chosen.cue for _, _, chosen in compiled.plate.spec.cue_choices()}
        if compiled.lifecycle is not None and compiled.lifecycle.birth is not None:
            named.add(compiled.lifecycle.birth.detector.detector)
    theirs = sorted(named & plugins.allowed())
    if theirs:
        options["allow_plugins"] = ",".join(theirs)
    return options
