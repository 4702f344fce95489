"""States of a net as its formula writes them: their names, and the laws of latent ones."""

from __future__ import annotations

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.spec import Given, Noise, OffsetBox, SizeBox


def text_state(name: str) -> str:
    """A state at the time of a frame."""
    return f"{name}_t"


def latex_state(name: str, time: str = "t") -> str:
    """A state as LaTeX."""
    return rf"\mathit{{{escape(name)}}}_{{{time}}}"


def escape(name: str) -> str:
    """A name in LaTeX."""
    return name.replace("_", r"\_")


def latent_nodes(target: CheckedTarget) -> list[tuple[str, str, Given]]:
    """Each latent state, the state that it is drawn around, and its noise."""
    states: dict[str, str] = {}
    found: list[tuple[str, str, Given]] = []
    for name in target.order:
        if name not in target.children:
            continue
        parent = target.parent[name]
        above = target.root if parent is None else states[parent]
        fuse = target.inference(name).fuse
        latent = fuse.latent if fuse is not None else None
        states[name] = above if latent is None else own_state(target, name)
        if latent is not None:
            found.append((states[name], above, latent.given))
    return found


def own_state(target: CheckedTarget, name: str) -> str:
    """A latent node's own state; a latent root has two, the target's and its own."""
    return f"{name}_own" if name == target.root else name


def moves(target: CheckedTarget, state: str) -> bool:
    """Whether a latent state is remembered, and so a part of what the belief is about."""
    return state in target.children and state != target.root and target.inference(state).motion is not None


def text_step(own: str, above: str) -> str:
    """How a state that is remembered moves."""
    state, given = text_state(own), text_state(above)
    return f"p({state} | {given}, {state}-1, {given}-1)"


def describe_held(target: CheckedTarget, state: str) -> str:
    """How a latent state is held, where it is not by hypotheses."""
    belief = target.inference(state).belief if state in target.children else None
    if belief is None or belief.particles is not None:
        return ""
    return "; its likelihood a Gaussian" if belief.gaussian is not None else "; its likelihood on a grid"


def place(given: Given) -> str:
    """Where in its parent's box a part lies."""
    if not given.is_part:
        return ""
    at, size = given.offset_box or OffsetBox(), given.size_box or SizeBox()
    x, y = (
        name if share == 0 else f"{name} {'-' if share < 0 else '+'} {abs(share):g} {side}"
        for name, share, side in (("x", at.x, "w"), ("y", at.y, "h"))
    )
    return f" around ({x}, {y}), {size.w:g} w by {size.h:g} h"


def noise(noise: Noise) -> str:
    """The sds of noise, with their units."""
    parts = (
        ("px", noise.sd_px),
        ("√(wh)", noise.sd_box),
        ("log", noise.sd_log),
    )
    said = [
        f"{field} {getattr(part, field):g} {unit}"
        for unit, part in parts
        for field in type(part).model_fields
        if getattr(part, field) > 0
    ]
    return "sd " + ", ".join(said) if said else ""
