"""The modes of a target in the formula of its net: how it moves in each, how long, and what follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.modes import Mode
from bayesnet_track.graph.settings.motion import Motion


def lines(target: CheckedTarget, describe: Callable[[Motion], str]) -> list[str]:
    """A line for each mode of the root, `describe` saying how a motion moves; none without modes."""
    modes = target.inference(target.root).modes
    if modes is None:
        return []
    return [f"mode {name}: {', '.join(_said(modes, name, describe))}" for name in modes]


def _said(modes: Mapping[str, Mode], name: str, describe: Callable[[Motion], str]) -> list[str]:
    mode = modes[name]
    said = ["moves so" if mode.motion is None else describe(mode.motion)]
    if mode.next is not None:
        said.append(f"next {_shares(mode.next)}")
    else:
        follow = mode.then or dict.fromkeys((other for other in modes if other != name), 1.0)
        said += [f"{mode.mean_frames:g} frames on average", f"then {_shares(follow)}"]
    if mode.hidden is not None:
        said.append(f"hidden: every agent says {mode.hidden.likelihood:g}")
    return said


def _shares(row: Mapping[str, float]) -> str:
    total = sum(row.values())
    if len(row) == 1:
        return next(iter(row))
    return ", ".join(f"{name} {share / total:.3g}" for name, share in row.items())
