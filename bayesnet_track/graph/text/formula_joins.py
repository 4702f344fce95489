"""The densities of targets that are joined, as text and as LaTeX."""

from __future__ import annotations

from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.write import latex_of, text_of
from bayesnet_track.graph.settings.joins import Join
from bayesnet_track.graph.text.formula_states import escape

_SHARED = "o_t: which one is in front; S_i: evidence of the pixels of box i that the other does not hide"


def join_text(join: Join) -> str:
    """What the joint belief of a pair is while its nets are joined, one equation a line."""
    first, second = _states(join)
    together = f"{first}_t, {second}_t"
    near = f"while the beliefs of {first} and {second} overlap by {join.when.overlap:g} or more:"
    lines = [near if join.when.overlap else f"of every {first} and {second}:"]
    if join.factor is not None:
        lines.append(f"p({together} | e_1:t) ∝ p({first}_t | e_1:t) · p({second}_t | e_1:t) · f({together})")
        lines.append(f"f(a, b) = {text_of(parse(join.factor))}")
    if join.shares_pixels:
        against = f" · e^(-{join.nats:g} c({together}))" if join.nats else ""
        lines.append(
            f"p({together} | e_1:t) ∝ p({first}_t | e_1:t-1) · p({second}_t | e_1:t-1) · "
            f"Σ_o p(o_t) · p(S_{first} | {together}, o_t) · p(S_{second} | {together}, o_t){against}"
        )
        lines.append(_SHARED)
        lines.append(f"p(o_t): {_order(join)}")
        lines += ["c: overlap as a share of the smaller box"] if join.nats else []
    if join.attachment is not None:
        one = join.attachment
        lines.append(
            f"p({second}_t | {second}_t-1, {first}_t): with {first}, sd {one.sd_px:g} px, while it is "
            f"carried (picked up with probability {one.start:g} a frame, stays carried with {one.stay:g})"
        )
    return "\n".join(lines)


def join_latex(join: Join) -> str:
    """The same as LaTeX (amsmath's `align*`), what is said in words as comments."""
    comments = [f"% {line}" for line in join_text(join).split("\n")]
    if join.factor is not None:
        one, other = (rf"\mathit{{{escape(name)}}}_{{t}}" for name in _states(join))
        each = r" \, ".join(rf"p({name} \mid e_{{1:t}})" for name in (one, other))
        return "\n".join(
            [
                comments[0],
                r"\begin{align*}",
                rf"p({one}, {other} \mid e_{{1:t}}) &\propto {each} \, f({one}, {other}) \\",
                rf"f(a, b) &= {latex_of(parse(join.factor))}",
                r"\end{align*}",
            ]
        )
    if not join.shares_pixels:
        return "\n".join(comments)
    first, second = (rf"\mathit{{{escape(name)}}}_{{t}}" for name in _states(join))
    pixels = [rf"p(S_{k} \mid {first}, {second}, o_t)" for k in (1, 2)]
    against = rf" \, e^{{-{join.nats:g} \, c({first}, {second})}}" if join.nats else ""
    priors = r" \, ".join(rf"p({one} \mid e_{{1:t-1}})" for one in (first, second))
    return "\n".join(
        [
            comments[0],
            r"\begin{align*}",
            rf"p({first}, {second} \mid e_{{1:t}}) &\propto {priors} \sum_{{o_t}} p(o_t) \, "
            rf"{pixels[0]} \, {pixels[1]}{against}",
            r"\end{align*}",
            *comments[2:],
        ]
    )


def _states(join: Join) -> tuple[str, str]:
    kinds = join.between or ("target",)
    return (kinds[0], kinds[1]) if len(set(kinds)) == 2 else (kinds[0], f"other_{kinds[0]}")


def _order(join: Join) -> str:
    if join.occlusion is None:
        return "1/2 each, anew in every frame"
    return f"that of the last frame with probability {join.stay:g}"
