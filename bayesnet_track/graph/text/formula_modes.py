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


def latex_lines(target: CheckedTarget, now: str, before: str) -> list[str]:
    """The joint prediction of state and mode, and how modes follow, as rows of `align*`; none without modes.

    `now` and `before` are the root's state in this frame and the last. Rows and columns of the matrix are in
    the order of the graph.
    """
    modes = target.inference(target.root).modes
    if modes is None:
        return []
    kernel = rf"p({now} \mid {before}, m_{{t}}) \, p({before}, m_{{t-1}} \mid e_{{1:t-1}})"
    predicted = rf"p({now}, m_{{t}} \mid e_{{1:t-1}})"
    chain = r"P(m_{t} \mid m_{t-1})"
    rows = r" \\ ".join(" & ".join(f"{value:.3g}" for value in row) for row in _matrix(modes))
    matrix = rf"\begin{{pmatrix}} {rows} \end{{pmatrix}}"
    by_steps = next(iter(modes.values())).next is not None
    power = rf"{matrix}^{{\Delta t}}" if by_steps else rf"\exp\left(\Delta t \, {matrix}\right)"
    return [
        rf"{predicted} &= \sum_{{m_{{t-1}}}} {chain} \int {kernel} \, d{before}",
        rf"{chain} &= \left[{power}\right]_{{m_{{t-1}}, m_{{t}}}}",
    ]


def _matrix(modes: Mapping[str, Mode]) -> list[list[float]]:
    """Transition probabilities of one frame interval, or rates, of each mode (rows) to each (columns)."""
    rows = []
    for name, mode in modes.items():
        if mode.next is not None:
            rows.append([mode.next.get(other, 0.0) for other in modes])
            continue
        follow = mode.then or dict.fromkeys((other for other in modes if other != name), 1.0)
        rate, total = 1.0 / (mode.mean_frames or 1.0), sum(follow.values())
        rows.append([-rate if other == name else rate * follow.get(other, 0.0) / total for other in modes])
    return rows


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
